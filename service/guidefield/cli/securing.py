"""`guidefield secure`: write certificates, passwords and Zenoh configurations of a service and its users.

Needs ``guidefield[secure]``. Users may use all keys below their own; a key that onlookers may read is listed here. The
keys are the wire's (`messages/keys.py`). A change reaches a service only when its files are written anew.
"""

from __future__ import annotations

import base64
import ipaddress
import json
import re
import secrets
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from guidefield.errors import MalformedRequest
from guidefield.messages.identities import base_key, check_user, shared_key

VALIDITY = timedelta(days=3650)  # of certificates
CLOCK_TOLERANCE = timedelta(hours=1)  # time before now from which they are valid, for clocks that are slow


@dataclass(frozen=True)
class Certificates:
    """Certificates in PEM; the authority's key is discarded, so that it never signs anything else."""

    authority: bytes
    service: bytes
    key: bytes  # of the service


def make_certificates(hosts: Sequence[str]) -> Certificates:
    """Make new certificates for the names and addresses by which clients reach the service."""
    now = datetime.now(UTC)
    root, own = ec.generate_private_key(ec.SECP256R1()), ec.generate_private_key(ec.SECP256R1())
    issuer, subject = _make_name("guidefield authority"), _make_name(hosts[0])

    def start_builder(whose: x509.Name, key: ec.EllipticCurvePublicKey) -> x509.CertificateBuilder:
        return (
            x509.CertificateBuilder()
            .subject_name(whose)
            .issuer_name(issuer)
            .public_key(key)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - CLOCK_TOLERANCE)
            .not_valid_after(now + VALIDITY)
        )

    authority = (
        start_builder(issuer, root.public_key())
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(root, hashes.SHA256())
    )
    service = (
        start_builder(subject, own.public_key())
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([_make_host(host) for host in hosts]), critical=False)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(root.public_key()), critical=False)
        .sign(root, hashes.SHA256())
    )
    pem = serialization.Encoding.PEM
    key = own.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    return Certificates(authority.public_bytes(pem), service.public_bytes(pem), key)


def _make_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name[:64])])


def _make_host(host: str) -> x509.GeneralName:
    return x509.IPAddress(ipaddress.ip_address(host)) if _is_address(host) else x509.DNSName(host)


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


ASK_MESSAGES = ["query", "declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]
"""Messages that a client sends to query and subscribe; flows of rules are the service's: it gets these on ingress."""
ANSWER_MESSAGES = ["reply", "put", "declare_queryable", "liveliness_token"]  # messages that a client gets, on egress
PRESENCE_MESSAGES = ["liveliness_token"]  # messages that declare a client's liveliness
PUT_MESSAGES, PUT_DECLARATIONS = ["put"], ["declare_subscriber"]
"""Messages that a client sends for its own stream, and the service's subscription for them."""
UPDATE_KEY = "streams/*/update"  # key of a stream's updates, below a user's
SUBSCRIBE_MESSAGES, PUBLISHED_MESSAGES = ["declare_subscriber"], ["put"]  # messages that a subscriber sends and gets
PUBLIC_KEYS = ("guidefield/*/alive", "guidefield/*/starting", "guidefield/*/starting/*")
"""Keys that everybody may read: the liveliness of services."""
LIST_KEYS = ("info", "robots", "scenes", "runs")  # keys that onlookers may read, below their own
SHARED_KEYS = ("robots/$*:$*", "scenes/$*:$*", "runs/$*:$*", "runs/$*:$*/recording", "runs/$*:$*/proof")
"""Keys of shared things: with an owner before the name they are read-only, except for operators."""


@dataclass(frozen=True)
class Roles:
    """Names by role: operators do everything, users have keys of their own, onlookers read lists and shared things."""

    operators: tuple[str, ...] = ("operator",)
    users: tuple[str, ...] = ("user",)
    onlookers: tuple[str, ...] = ("onlooker",)

    def everybody(self) -> tuple[str, ...]:
        """Return all names."""
        return (*self.operators, *self.users, *self.onlookers)


def access_control(roles: Roles) -> dict[str, Any]:
    """Make the section ``access_control`` of the service's Zenoh configuration, which denies by default."""
    published = [f"{shared_key('*')}/**"]
    rules: list[dict[str, Any]] = [
        *_make_rules("everybody", PUBLIC_KEYS),
        _make_rule("everybody listens", SUBSCRIBE_MESSAGES, "ingress", published),
        _make_rule("everybody hears", PUBLISHED_MESSAGES, "egress", published),
    ]
    policies: list[dict[str, Any]] = [{"rules": _ids(rules), "subjects": list(roles.everybody())}]
    of_roles = [
        *((name, ["guidefield/**"], base_key("*", "plain")) for name in roles.operators),
        *((name, [f"{base_key('*', name)}/**"], base_key("*", name)) for name in roles.users),
        *(
            (name, [f"{base_key('*', name)}/{key}" for key in (*LIST_KEYS, *SHARED_KEYS)], None)
            for name in roles.onlookers
        ),
    ]
    for name, keys, present in of_roles:
        own = _make_rules(f"user {name}", keys, None if present is None else f"{present}/clients/*")
        if present is not None:
            updates = [f"{present}/{UPDATE_KEY}"]
            own.append(_make_rule(f"user {name} sends updates", PUT_MESSAGES, "ingress", updates))
            own.append(_make_rule(f"user {name} may send updates", PUT_DECLARATIONS, "egress", updates))
        rules += own
        policies.append({"rules": _ids(own), "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "usernames": [name]} for name in roles.everybody()],
        "policies": policies,
    }


def _make_rules(who: str, keys: Sequence[str], present: str | None = None) -> list[dict[str, Any]]:
    found = [
        _make_rule(f"{who} asks", ASK_MESSAGES, "ingress", keys),
        _make_rule(f"{who} is answered", ANSWER_MESSAGES, "egress", keys),
    ]
    return (
        found if present is None else [*found, _make_rule(f"{who} is there", PRESENCE_MESSAGES, "ingress", [present])]
    )


def _make_rule(name: str, messages: Sequence[str], flow: str, keys: Iterable[str]) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "messages": list(messages),
        "flows": [flow],
        "key_exprs": list(keys),
    }


def _ids(rules: Iterable[dict[str, Any]]) -> list[str]:
    return [rule["id"] for rule in rules]


LOCAL_HOSTS = ("localhost", "127.0.0.1")  # names of a service on the client's own machine
SECRET_BYTES = 24  # random bytes of a password
HOST_NAME = re.compile(r"(\*\.)?[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*")
READABLE, SECRET = 0o644, 0o600  # modes of files; those with a password or key are readable by their owner only


def write_files(folder: Path, roles: Roles, hosts: tuple[str, ...], port: int) -> list[Path]:
    """Write certificates, passwords and Zenoh configurations into a folder, which is created, and return the files.

    The service's configuration comes first, then those of the clients, with the first host, then the service's files.

    Raises:
        MalformedRequest: if a name can't be a user's or host's, or two users have the same, or a file is there already.
    """
    names = roles.everybody()
    for name in names:
        check_user(name)
    if len(set(names)) < len(names):
        raise MalformedRequest(f"each name has one role, got {', '.join(names)}", names=list(names))
    for host in hosts:
        if not (HOST_NAME.fullmatch(host) or _is_address(host)):
            raise MalformedRequest(f"a host is a name or an address without protocol and port, got {host!r}", host=host)
    made = make_certificates(hosts)
    passwords = {name: secrets.token_urlsafe(SECRET_BYTES) for name in names}
    where = folder.resolve()
    users = "".join(f"{name}:{password}\n" for name, password in passwords.items())
    clients = dict[str, bytes]()
    for name, password in passwords.items():
        own = client_configuration(name, name in roles.operators, password, made.authority, hosts[0], port)
        clients[name] = _add_comment(CLIENT.format(name=name), own)
    files: dict[str, tuple[bytes, int]] = {
        "service.json5": (_add_comment(SERVICE, service_configuration(roles, where, port)), READABLE),
        **{f"{name}.json5": (content, SECRET) for name, content in clients.items()},
        "service.pem": (made.service, READABLE),
        "service.key": (made.key, SECRET),
        "users.txt": (users.encode(), SECRET),
    }
    return _write_files(where, files)


def service_configuration(roles: Roles, folder: Path, port: int) -> dict[str, Any]:
    """Make the Zenoh configuration of a service whose other files are in a folder."""
    tls = {"listen_certificate": str(folder / "service.pem"), "listen_private_key": str(folder / "service.key")}
    return {
        "mode": "peer",
        "listen": {"endpoints": [f"tls/0.0.0.0:{port}"]},
        "transport": {
            "link": {"tls": tls},
            "auth": {"usrpwd": {"dictionary_file": str(folder / "users.txt")}},
        },
        "access_control": access_control(roles),
    }


def client_configuration(
    name: str, operator: bool, password: str, authority: bytes, host: str, port: int
) -> dict[str, Any]:
    """Make the Zenoh configuration of a client, with the user whose keys the Python client uses."""
    configuration: dict[str, Any] = {
        "mode": "client",
        "connect": {"endpoints": [f"tls/[{host}]:{port}" if ":" in host else f"tls/{host}:{port}"]},
        "transport": {
            "link": {"tls": {"root_ca_certificate_base64": base64.b64encode(authority).decode()}},
            "auth": {"usrpwd": {"user": name, "password": password}},
        },
    }
    return configuration if operator else {**configuration, "metadata": {"guidefield": {"user": name}}}


SERVICE = """A service that whole networks can reach: encrypted, by user and password, each user on keys of its own.

    guidefield serve --config service.json5

The files that it names are the service's alone: service.key, and users.txt with a line name:password for each user."""
CLIENT = """All that {name} needs to use the service. It holds a password: give it to nobody else.

    guidefield query request.json --config {name}.json5
    Client.connect(config=Path("{name}.json5"))"""


def _add_comment(text: str, configuration: dict[str, Any]) -> bytes:
    comment = "".join(f"// {line}".rstrip() + "\n" for line in text.splitlines())
    return f"{comment}{json.dumps(configuration, indent=2)}\n".encode()


def _write_files(folder: Path, files: dict[str, tuple[bytes, int]]) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    there = [name for name in files if (folder / name).exists()]
    if there:
        reason = f"{folder} holds {', '.join(there)} already; name another folder, or delete what is to be made anew"
        raise MalformedRequest(reason, path=str(folder))
    for name, (content, rights) in files.items():
        path = folder / name
        path.touch(mode=rights)
        path.write_bytes(content)
    return [folder / name for name in files]
