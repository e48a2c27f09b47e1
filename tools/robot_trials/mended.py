"""The text of a robot for the judge, mended where `robots.md` says how a fault is read."""

from __future__ import annotations

from xml.etree import ElementTree


def mend(text: str) -> str:
    """Exchange reversed limits, and give sources of mimic joints the prefix that they lack."""
    root = ElementTree.fromstring(text)  # noqa: S314 - the service has read it
    names = [joint.get("name", "") for joint in root.findall("joint")]
    for joint in root.findall("joint"):
        for limit in joint.findall("limit"):
            lower, upper = limit.get("lower", "0"), limit.get("upper", "0")
            if float(lower) > float(upper):
                limit.attrib.update(lower=upper, upper=lower)
        for mimic in joint.findall("mimic"):
            source, own = mimic.get("joint", ""), joint.get("name", "")
            meant = [name for name in names if name.endswith(source) and own.startswith(name.removesuffix(source))]
            if source not in names:
                (mimic.attrib["joint"],) = [name for name in meant if name != own]
    return ElementTree.tostring(root, encoding="unicode")
