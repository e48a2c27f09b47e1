"""README, the pages and the public docstrings do what they say: commands and Python are run, messages are sent."""

import doctest
import inspect
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from click import Command
from typer.main import get_command
from typer.testing import CliRunner

import guidefield
from guidefield.cli import app
from guidefield.messages import codec, identities, replies, requests, scene, scene_changes
from guidefield.messages.codec import Encoding
from tests.journeys.service import Service, plain_client, running_service

HOUSE = Path(__file__).resolve().parent.parent
DOCS = HOUSE / "service" / "docs"
README = HOUSE / "README.md"
PAGES = (README, HOUSE / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md")))
MOST_WORDS = 700  # README is read in a minute; what is longer is a page
ON_A_PAGE = "tcp/127.0.0.1:7447"
UNHURRIED = 120.0  # how long a plan may take on a busy machine [s]
NOT_RUN = {"batch", "demo", "execute", "mcp", "serve", "show"}
"""Commands that go on until somebody ends them, or that have journeys of their own: their words alone are checked."""
BLOCK = re.compile(r"^```(?P<language>\w+)(?: (?P<words>[^\n]+))?\n(?P<text>.*?)^```", re.DOTALL | re.MULTILINE)
ARM = """<robot name="mine">
  <link name="base"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="arm"><collision><origin xyz="0 0 0.5"/><geometry><box size="0.05 0.05 0.6"/></geometry></collision></link>
  <joint name="joint1" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
</robot>"""


class Block(NamedTuple):
    """A block of code of a page: its language, the words behind it (a message and where it goes), and its text."""

    language: str
    words: tuple[str, ...]
    text: str


def _blocks(page: Path) -> list[Block]:
    found = BLOCK.finditer(page.read_text())
    return [Block(block["language"], tuple((block["words"] or "").split()), block["text"]) for block in found]


def _commands(page: Path) -> list[list[str]]:
    """The words of each line of a page that begins with `guidefield`."""
    lines = [line for block in _blocks(page) if block.language == "sh" for line in block.text.splitlines()]
    words = [shlex.split(line, comments=True) for line in lines]
    return [line[1:] for line in words if line and line[0] == "guidefield"]


def _meant(words: list[str]) -> tuple[Command, list[str]]:
    """The command that some words mean, and the words that are left for it."""
    command: Any = get_command(app)
    while (subcommands := getattr(command, "commands", None)) is not None:
        assert words[0] in subcommands, f"there is no command {words[0]!r}"
        command, words = subcommands[words[0]], words[1:]
    return command, words


def _key(block: Block) -> str | None:
    """The key to which a message on a page is sent, if it is."""
    return block.words[1] if len(block.words) > 1 and "/" in block.words[1] else None


def _unhurried(block: Block) -> str:
    """The text of a block; a plan has time enough on a busy machine, too, where its replay would differ otherwise."""
    if block.words[0] != "PlanRequest":
        return block.text
    return json.dumps({"allowed_planning_time": UNHURRIED, **json.loads(block.text)})


def _have_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plans that a page asks for in Python have time enough on a busy machine, too, where it leaves that open."""
    answer, plan = guidefield.answer, guidefield.Client.plan

    def unhurried(request: Any, *args: Any, **options: Any) -> Any:
        planned = isinstance(request, dict) and request.get("type", "plan") == "plan"
        return answer({"allowed_planning_time": UNHURRIED, **request} if planned else request, *args, **options)

    def unhurried_plan(client: guidefield.Client, *args: Any, **fields: Any) -> Any:
        return plan(client, *args, **fields if args else {"allowed_planning_time": UNHURRIED, **fields})

    monkeypatch.setattr(guidefield, "answer", unhurried)
    monkeypatch.setattr(guidefield.Client, "plan", unhurried_plan)


def _talks(page: Path) -> bool:
    """Whether a page needs a service."""
    return ON_A_PAGE in page.read_text() or any(_key(block) for block in _blocks(page))


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """One service for all pages, its data where the command line looks for those of a user."""
    data = tmp_path_factory.mktemp("home") / "guidefield" / "local"
    with running_service(data, "--workers", "1", "--prepare", "ur5") as running:
        yield running


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with what the pages take for granted: a robot of one's own, and the source's tools."""
    (tmp_path / "my_robot.urdf").write_text(ARM)
    argument = 'xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="with_tool" default="false"/>'
    (tmp_path / "my_robot.urdf.xacro").write_text(ARM.replace(">", f" {argument}", 1))
    (tmp_path / "tools").symlink_to(HOUSE / "tools")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_does_what_it_says(page, desk, monkeypatch, capsys, request):
    endpoint = ON_A_PAGE
    _have_time(monkeypatch)
    if _talks(page):
        service = request.getfixturevalue("service")
        endpoint = service.endpoint
        monkeypatch.setenv("XDG_DATA_HOME", str(service.data.parent.parent))
    blocks = _blocks(page)
    for block in blocks:
        if block.words and (block.language, block.words[-1].rpartition(".")[2]) in (("json", "json"), ("csv", "csv")):
            (desk / block.words[-1]).write_text(_unhurried(block))
    for block in blocks:
        text = block.text.replace(ON_A_PAGE, endpoint)
        if block.language == "python":
            exec(compile(text, page.name, "exec"), {"__name__": "__main__"})
            if "reply.status" in text:
                assert "SUCCESS" in capsys.readouterr().out
        elif block.language == "sh":
            for line in text.splitlines():
                _run(shlex.split(line, comments=True))
        elif (key := _key(block)) is not None:
            with plain_client(endpoint) as client:
                answer = client.answer(key, _unhurried(block).encode())
                assert answer.is_reply, answer.payload
                if block.words[0] in ("PlanRequest", "CertifyRequest"):
                    assert answer.json()["status"]["name"] == "SUCCESS"


@pytest.mark.parametrize(
    "name", ["answer", "CertifyReply", "Client", "PlanReply", "PlanRequest", "Stream", "StreamOpen"]
)
def test_a_public_docstring_has_an_example_that_holds(name: str, request: pytest.FixtureRequest) -> None:
    text = inspect.getdoc(getattr(guidefield, name)) or ""
    if ON_A_PAGE in text:
        text = text.replace(ON_A_PAGE, request.getfixturevalue("service").endpoint)
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert len(example.examples) >= 4
    done = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example)
    assert done.failed == 0


def _run(words: list[str]) -> None:
    """Run a command of ours; of others only see that they are there."""
    if not words or words[0] != "guidefield":
        assert not words or words[0].startswith(("tools/", ".ci/", ".venv/bin/")) or words[:2] == ["pip", "install"], (
            words
        )
        return
    if words[1] in NOT_RUN or "--config" in words:
        return
    done = CliRunner().invoke(app, words[1:])
    assert done.exit_code == 0, (words, done.output, done.exception)
    assert done.output or "export" in words


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_have_the_words_that_a_page_gives_them(page: Path, desk: Path) -> None:
    for words in _commands(page):
        command, rest = _meant(words)
        command.make_context(" ".join(words), rest)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_messages_on_a_page_are_messages(page: Path) -> None:
    """Each is read by the real codec, in both encodings, and keeps all that the page gives it."""
    for block in _blocks(page):
        if block.language != "json":
            continue
        assert block.words, f"{page.name}: a JSON block names its message: {block.text[:40]}"
        name = block.words[0]
        rooms = (requests, replies, scene, scene_changes, identities)
        kind = next(getattr(room, name) for room in rooms if hasattr(room, name))
        message = codec.decode(block.text.encode(), kind)
        assert codec.decode(codec.encode(message, Encoding.MSGPACK), kind, Encoding.MSGPACK) == message
        _assert_within(json.loads(block.text), json.loads(codec.encode(message)), name)


def _assert_within(part: Any, whole: Any, path: str) -> None:
    """All that is in plain data is in other plain data, too."""
    if isinstance(part, dict):
        for key, value in part.items():
            assert key in whole, f"{path}.{key} is no field"
            _assert_within(value, whole[key], f"{path}.{key}")
    elif isinstance(part, list):
        assert len(part) == len(whole), path
        for index, (one, other) in enumerate(zip(part, whole, strict=True)):
            _assert_within(one, other, f"{path}[{index}]")
    else:
        assert part == whole, path


def test_pages_for_a_quick_look_are_short() -> None:
    newest = re.split(r"^## ", (HOUSE / "CHANGELOG.md").read_text(), flags=re.MULTILINE)[1]
    assert len(README.read_text().split()) <= MOST_WORDS
    assert len(newest.split()) <= 800
    assert len((DOCS / "benchmarks.md").read_text().split()) <= 1500


def test_the_service_page_has_every_option() -> None:
    serve, _ = _meant(["serve"])
    options = {name for parameter in serve.params for name in parameter.opts}
    told = re.findall(r"^\| `(--[\w-]+)`", (DOCS / "service.md").read_text(), re.MULTILINE)
    assert options - {"--help"} == set(told)


def test_the_scenes_page_has_every_kind_of_obstacle() -> None:
    text = (DOCS / "scenes.md").read_text()
    kinds = {kind.__struct_config__.tag for kind in scene.Obstacle.__args__}
    assert kinds == set(re.findall(r"^\| `(\w+)`", text, re.MULTILINE))


def test_every_page_is_linked_from_the_readme() -> None:
    assert {page.name for page in DOCS.glob("*.md")} <= {
        Path(target).name for target in re.findall(r"\]\((service/docs/[\w.]+)", README.read_text())
    }


def test_terms_are_in_order() -> None:
    rows = re.findall(r"^\| (.+?) \| (.+?) \| (.+) \|$", (DOCS / "glossary.md").read_text(), re.MULTILINE)
    terms = [term for term, _, _ in rows[1:]]
    assert 25 < len(terms) <= 60
    assert terms == sorted(terms, key=str.casefold)
