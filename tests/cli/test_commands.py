"""The commands: what they print, what they write, how they end; some in a process of their own, the others here."""

import contextlib
import io
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.parse import unquote
from urllib.request import ProxyHandler, build_opener

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from guidefield import Scene
from guidefield.cli import app, main
from guidefield.cli.serving import free_port
from guidefield.engine import answer
from guidefield.errors import Status
from guidefield.messages.requests import ReadRobot, UrdfFile
from tests.journeys.service import running_service
from tests.replies import plan_reply

ROBOTS = Path(__file__).resolve().parent.parent.parent / "robots"
opened = build_opener(ProxyHandler({})).open  # opens a page of this machine, whatever proxy there is for others
POTENTIAL = {"type": "potential", "scene": "bookshelf", "points": [[0, 0, 2]]}


def guidefield(*arguments: str, stdin: str | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "guidefield", *arguments],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def here(*arguments: str, stdin: str | None = None) -> subprocess.CompletedProcess[str]:
    """The same in this process, which has loaded all that it needs."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    with pytest.MonkeyPatch.context() as patched, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        patched.setattr(sys, "argv", ["guidefield", *arguments])
        patched.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO((stdin or "").encode())))
        try:
            main()
        except SystemExit as ended:
            code = 0 if ended.code is None else int(ended.code)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), err.getvalue())


@pytest.fixture
def request_file(tmp_path: Path) -> Path:
    file = tmp_path / "request.json"
    file.write_text(json.dumps(POTENTIAL))
    return file


def test_a_request_from_a_file_is_answered_to_a_file(request_file: Path, tmp_path: Path) -> None:
    done = guidefield("plan", str(request_file), "-o", str(tmp_path / "reply.json"))
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "reply.json").read_text())["potential"][0] > 0.0
    assert done.stdout == ""


def test_a_request_from_standard_input_is_answered_to_standard_output() -> None:
    done = here("plan", "-", stdin=json.dumps(POTENTIAL))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["potential"][0] > 0.0


def test_what_a_motion_is_optimised_for_may_be_said_beside_the_request() -> None:
    asked = {"robot": "ur5", "scene": {"name": "empty"}, "goal": {"type": "joints", "positions": {"elbow_joint": 0.2}}}
    patient = json.dumps({**asked, "allowed_planning_time": 60.0, "recording": "off"})
    done = here("plan", "-", "--objective", "time", stdin=patient)
    assert done.returncode == 0, done.stderr
    assert "objective time" in done.stdout
    done = here("plan", "-", "--objective", "time", stdin=json.dumps(POTENTIAL))
    assert done.returncode == 2
    assert "--objective goes with a plan request, not with a Potential" in done.stderr


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        ("{}", "MALFORMED_REQUEST"),
        ('{"type": "robot", "robot": "r2d2"}', "ROBOT_INVALID"),
        ('{"type": "scene", "name": "nowhere"}', "SCENE_INVALID"),
    ],
)
def test_what_is_ill_posed_ends_with_2_and_one_line(request_: str, says: str) -> None:
    done = here("plan", "-", stdin=request_)
    assert done.returncode == 2
    assert done.stderr.startswith(says)
    assert "Traceback" not in done.stderr


def test_a_scene_comes_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "scan.xyz").write_text("100 200 300\nnan 0 0\n")
    scan, scene = str(tmp_path / "scan.xyz"), str(tmp_path / "cell.json")
    for arguments, says in (
        (("scenes", "import", scan, "-o", scene), "give their `radius` [m] (--radius)"),
        (("scenes", "import", scan, "--radius", "0.01", "--without", "scam", "-o", scene), "did you mean scan?"),
        (("plan", "-", "--scene", "table", "--scale", "2"), "--scale and --radius go with a --scene that is a file"),
        (("plan", "-", "--scene", str(tmp_path / "lost.stl")), "lost.stl can't be opened: No such file"),
        (("plan", "-", "--scene", str(ROBOTS / "__init__.py")), "is no scene file; one ends in .json"),
    ):
        done = here(*arguments, stdin="{}")
        assert (done.returncode, says in done.stderr) == (2, True), done.stderr
    options = ("--radius", "10", "--scale", "0.001", "--up", "y", "--as", "cell", "--prefix", "a ", "-o", scene)
    done = here("scenes", "import", scan, *options)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{scene}: 1 obstacle: a scan\n"
    assert (
        done.stderr == "warning: scan.xyz: 1 points with coordinates that are NaN are left out: nothing was measured\n"
    )
    (cloud,) = Scene.read(scene).obstacles
    assert (cloud.points, cloud.radius) == ([(0.1, -0.3, 0.2)], 10.0)
    asked = json.dumps({"type": "potential", "points": [[0, 0, 2]]})
    assert json.loads(here("plan", "-", "--scene", scene, stdin=asked).stdout)["potential"][0] > 0.0


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    done = here("plan", str(tmp_path / "nothing.json"))
    assert done.returncode == 2
    assert "nothing.json" in done.stderr


def test_a_file_that_is_no_request_is_named_with_the_line(tmp_path: Path) -> None:
    file = tmp_path / "broken.json"
    file.write_text('{"robot": "panda",\n "scene": }')
    done = here("plan", str(file))
    assert done.returncode == 2
    assert f"{file}: the payload is not application/json" in done.stderr
    assert "line 2, column 11" in done.stderr


def test_nobody_to_query_is_said(request_file: Path) -> None:
    with free_port() as port:
        done = guidefield("query", str(request_file), "--connect", f"tcp/127.0.0.1:{port}")
    assert done.returncode == 2
    assert done.stderr.startswith("COMMUNICATION_FAILURE: nobody listens at tcp/127.0.0.1")
    assert ".rs" not in done.stderr
    for options, says in (("--connect", "nonsense"), "got nonsense"), (("--config", "none.json5"), "none.json5"):
        done = here("query", str(request_file), *options)
        assert done.returncode == 2
        assert says in done.stderr
        assert "Traceback" not in done.stderr
        assert ".rs:" not in done.stderr


def test_a_service_is_queried(request_file: Path, plan_file: Path, tmp_path: Path) -> None:
    """An eager one, whose worker renders each recording before its next query, and the last before it ends."""
    recording, kept = tmp_path / "run.rrd", tmp_path / "data" / "recordings"
    options = ("--workers", "1", "--name", "cell", "--recordings", "eager")
    with running_service(tmp_path / "data", *options) as service:
        asked = ("query", str(request_file), "--connect", service.endpoint)
        plan = ("query", str(plan_file), "--connect", service.endpoint)
        assert "SUCCESS" in here(*plan).stdout
        done = guidefield(*asked, "--name", "cell")
        assert done.returncode == 0, done.stderr
        assert [file.suffix for file in kept.iterdir()] == [".rrd"]
        assert done.stdout == here("plan", str(request_file)).stdout
        assert here(*asked).stdout == done.stdout
        assert "no service named 'local' is there; there is 'cell'" in here(*asked, "--name", "local").stderr
        done = here(*plan, "--record", str(recording))
        assert "SUCCESS" in here(*plan).stdout
    assert done.returncode == 0, done.stderr
    assert "SUCCESS" in done.stdout
    assert recording.stat().st_size > 10_000
    assert [file.suffix for file in kept.iterdir()] == [".rrd"] * 3


def test_robots_are_listed_for_people_and_for_machines() -> None:
    listed = json.loads(here("robots", "--json").stdout)["robots"]
    assert {"panda", "ur5"} <= {robot["name"] for robot in listed}
    table = here("robots")
    assert table.returncode == 0
    assert "panda" in table.stdout
    assert "tip panda_hand_tcp" in here("robots", "panda").stdout


def test_a_robot_of_ones_own_is_described_from_its_file(tmp_path: Path) -> None:
    urdf = ROBOTS / "chain_fixed_6x320_r25.urdf"
    shown = json.loads(here("robots", str(urdf), "--json").stdout)
    reply = answer(ReadRobot(UrdfFile(str(urdf))))
    assert [joint["name"] for joint in shown["joints"]] == [joint.name for joint in reply.joints]
    assert len(reply.joints) == 6
    (tmp_path / "bad.urdf").write_text(urdf.read_text().replace("</robot>", ""))
    refused = here("robots", str(tmp_path / "bad.urdf"))
    assert refused.returncode == 2
    assert "ROBOT_INVALID" in refused.stderr
    missing = here("robots", str(tmp_path / "none.urdf"))
    assert "none.urdf" in missing.stderr
    assert "Traceback" not in missing.stderr


@pytest.fixture
def occupied_port() -> Iterator[int]:
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        yield listening.getsockname()[1]


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    done = here("demo", "--folder", str(tmp_path / "file"))
    assert (done.returncode, done.stderr) == (2, f"FileExistsError: {tmp_path / 'file'}: File exists\n")


def test_a_service_that_cannot_start_says_why_in_one_line(tmp_path: Path, occupied_port: int) -> None:
    config = tmp_path / "zenoh.json5"
    config.write_text("{ lisen: {} }")
    for options, says in (
        (["--config", str(config)], "lisen"),
        (["--listen", "nonsense"], "nonsense"),
        (["--listen", "tcp/127.0.0.1"], "an endpoint is written like tcp/127.0.0.1:7447"),
        (["--listen", f"tcp/127.0.0.1:{occupied_port}"], "give another --listen"),
        (["--data", str(config)], f"the data folder '{config}' can't be written"),
        (["--name", "a/b"], "a/b"),
    ):
        done = guidefield("serve", "--data", str(tmp_path / "data"), *options)
        assert done.returncode == 2
        assert says in done.stderr
        assert "Traceback" not in done.stderr
        assert ".rs:" not in done.stderr


def test_the_command_line_starts_without_what_few_commands_need() -> None:
    told = subprocess.run(
        [sys.executable, "-c", "import sys, guidefield.cli; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    heavy = {"numpy", "asyncio", "guidefield.client", "guidefield.engine", "guidefield.endpoint.service"}
    assert heavy.isdisjoint(told.stdout.split())


@pytest.mark.parametrize(("status", "code"), [(Status.SUCCESS, 0), (Status.STUCK_IN_MINIMUM, 1), (Status.TIMED_OUT, 1)])
def test_the_exit_code_is_the_outcome(status, code, tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from guidefield import engine

    def answer(_request: Any, **_about: Any) -> Any:
        return plan_reply("r1", status)

    monkeypatch.setattr(engine, "answer", answer)
    request = {"robot": "panda", "scene": "bookshelf", "goal": {"type": "guide_plane"}}
    result = CliRunner().invoke(app, ["plan", "-", "-o", str(tmp_path / "reply.json")], input=json.dumps(request))
    assert result.exit_code == code
    assert json.loads((tmp_path / "reply.json").read_text())["status"]["name"] == status.name


def test_the_viewer_is_opened_on_this_machine_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from typer.testing import CliRunner

    from guidefield.cli import app, showing

    called: list[list[str]] = []
    monkeypatch.setattr(showing.subprocess, "call", lambda command, **_: called.append(command) or 0)
    (tmp_path / "run.rrd").write_bytes(b"")
    monkeypatch.setattr(showing, "has_display", lambda: False)
    assert "with --web" in str(CliRunner().invoke(app, ["show", str(tmp_path / "run.rrd")]).exception)
    assert called == []
    monkeypatch.setattr(showing, "has_display", lambda: True)
    assert CliRunner().invoke(app, ["show", str(tmp_path / "run.rrd")]).exit_code == 0
    assert called[0][3:] == ["--bind", "127.0.0.1", str(tmp_path / "run.rrd")]
    assert "there is no recording" in str(CliRunner().invoke(app, ["show", str(tmp_path / "nothing.rrd")]).exception)


def test_a_web_viewer_that_does_not_answer_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from typer.testing import CliRunner

    from guidefield.cli import app, showing

    monkeypatch.setattr(showing, "SERVER_START_TIME_S", 0.5)
    (tmp_path / "run.rrd").write_bytes(b"")
    for does, told in (("import time; time.sleep(60)", "did not answer within 0.5 s"), ("raise SystemExit(7)", "")):
        monkeypatch.setattr(showing, "viewer_command", lambda does=does: [sys.executable, "-c", does])
        ended = CliRunner().invoke(app, ["show", "--web", str(tmp_path / "run.rrd")])
        assert told in str(ended.exception)
        assert ended.exit_code == (1 if told else 7)


def test_a_recording_is_served_to_browsers_until_sigterm(tmp_path: Path) -> None:
    (tmp_path / "run.rrd").write_bytes(b"a recording")
    command = [sys.executable, "-m", "guidefield", "show", "--web", str(tmp_path / "run.rrd")]
    quiet = {name: text for name, text in os.environ.items() if name not in {"DISPLAY", "WAYLAND_DISPLAY"}}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=quiet) as process:
        page, file = process.stdout.readline().split(" is at ")[1].strip().split("/?url=")
        try:
            with opened(page) as viewer:
                assert b"rerun" in viewer.read().lower()
            with opened(unquote(file)) as content:
                assert content.read() == b"a recording"
                assert content.headers["Access-Control-Allow-Origin"] == "*"
        finally:
            process.terminate()
        assert process.wait() == 0
    with pytest.raises(URLError):
        opened(page)


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    request = {
        "robot": "xarm7",
        "scene": "table",
        "goal": {"type": "joints", "positions": {"joint1": 0.3}},
        "guide_planes": [],
        "allowed_planning_time": 60,
    }
    file = tmp_path / "plan.json"
    file.write_text(json.dumps(request))
    return file


def test_a_plan_is_a_table_a_reply_and_a_recording(plan_file: Path, tmp_path: Path) -> None:
    reply, recording = tmp_path / "reply.json", tmp_path / "run.rrd"
    done = here("plan", str(plan_file), "-o", str(reply), "--record", str(recording))
    assert done.returncode == 0, done.stderr
    for said in ("SUCCESS", "clearance", "certificate", "free: the trajectory", "time", "recording", "to open it"):
        assert said in done.stdout
    assert json.loads(reply.read_text())["recording"] == str(recording)
    assert recording.stat().st_size > 10_000


def test_a_recording_and_a_proof_are_written_only_where_they_are_found_again(plan_file: Path, tmp_path: Path) -> None:
    """The commands that read such files know them by their suffix."""
    for option, suffix in (("--record", ".rrd"), ("--proof", ".npz")):
        done = here("plan", str(plan_file), option, str(tmp_path / "run.txt"))
        assert done.returncode == 2
        assert f"ends with {suffix}" in " ".join(done.stderr.split())
        assert not (tmp_path / "run.txt").exists()


def test_the_demo_plans_twice_and_leaves_recordings(tmp_path: Path) -> None:
    done = guidefield("demo", "--folder", str(tmp_path / "runs"))
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("SUCCESS") == 2
    assert done.stdout.count("to open it") == 2
    assert {path.name for path in (tmp_path / "runs").iterdir()} == {"demo-guide-planes.rrd", "demo-pose.rrd"}


def test_each_option_of_a_service_has_a_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    command = get_command(app).commands["serve"]
    monkeypatch.setenv("GUIDEFIELD_WORKERS", "3")
    monkeypatch.setenv("GUIDEFIELD_LISTEN", "tcp/127.0.0.1:1 tcp/127.0.0.1:2")
    monkeypatch.setenv("GUIDEFIELD_JSON_LOGS", "1")
    asked = command.make_context("serve", []).params
    assert (asked["workers"], asked["json_logs"]) == (3, True)
    assert list(asked["listen"]) == ["tcp/127.0.0.1:1", "tcp/127.0.0.1:2"]
    assert command.make_context("serve", ["--workers", "4"]).params["workers"] == 4
    monkeypatch.setenv("GUIDEFIELD_WORKERS", "0")
    refused = CliRunner().invoke(app, ["serve"])
    assert (refused.exit_code, "--workers" in refused.output) == (2, True)


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        ("se", ["serve", "secure"]),
        ("robots allegro_l", ["allegro_left_hand"]),
        ("certify motion.csv --scene tab", ["table"]),
        ("docs PlanRe", ["PlanRequest", "PlanReply"]),
        ("docs quick", ["quickstart"]),
    ],
)
def test_a_shell_completes_commands_and_names(words: str, completed: list[str]) -> None:
    asking = {
        "_GUIDEFIELD_COMPLETE": "complete_bash",
        "COMP_WORDS": f"guidefield {words}",
        "COMP_CWORD": str(len(words.split())),
    }
    done = CliRunner().invoke(app, [], env=asking, prog_name="guidefield")
    assert done.output.split() == completed
