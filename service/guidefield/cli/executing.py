"""`guidefield execute`: send the certified motion of a run to a controller of ros2_control, watch it, judge it.

The rows that are sent are those that were certified, unchanged; whatever ends the command must still stop the robot
(`endpoint/ros/trajectory_action.py`).
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from guidefield.cli.found_run import (
    Data,
    RunName,
    Service,
    data_folder,
    find_run,
    owner_of,
    replaying_engine,
    require_recording_file,
    require_writable,
)
from guidefield.cli.tables import motion_table
from guidefield.errors import MalformedRequest
from guidefield.messages.certify_reply import JointStates, judgement_of
from guidefield.messages.execution import ExecutionFigures, SentMotion, trajectory_message, write_table
from guidefield.messages.replies import CertifyReply, PlanReply
from guidefield.messages.requests import PlanRequest

if TYPE_CHECKING:
    import numpy as np

# chord error of the polyline on which the controller's desired place is searched [rad or m]; it must stay far below
# `CURVE_TOLERANCE` of `endpoint/ros/trajectory_action.py`
CHORD_TOLERANCE = 1e-5


def execute(
    run: RunName,
    ros_controller: Annotated[str, typer.Option(help="Name of the controller, as ros2 control lists it.")],
    ros_domain: Annotated[int, typer.Option(min=0, max=232, help="Its ROS domain.")] = 0,
    ros_connect: Annotated[
        str, typer.Option(help="Zenoh endpoint of the router that it is reached through, usually rmw_zenohd's.")
    ] = "tcp/localhost:7447",
    patience: Annotated[float, typer.Option(min=0.1, help="How long nothing may be heard, in seconds.")] = 5.0,
    states: Annotated[
        Path | None, typer.Option(help="Write the robot's states to this .csv.", callback=require_writable)
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            help="Judge what was executed, and write its recording to this .rrd.", callback=require_recording_file
        ),
    ] = None,
    data: Data = None,
    name: Service = "local",
) -> None:
    """Have a controller of ros2_control execute the certified motion of a run, over rmw_zenoh, and watch it.

    The run must be certified for linear, cubic or quintic interpolation, and the robot at its start. Ctrl-C cancels,
    as do SIGTERM and SIGHUP. Where the robot leaves its tolerance is reported.

    Exit code 0 where it succeeded within its tolerance, 1 where it didn't, 2 for an error.
    """
    try:
        from guidefield.endpoint.ros.trajectory_action import MotionToExecute, controller_at
    except ImportError:
        raise MalformedRequest("controllers are spoken to by rosbags: pip install 'guidefield[ros]'") from None

    found = find_run(run, data, name)
    reply = found.reply
    reply.export("ros.json")  # says why, if that isn't certified
    if record is not None and not isinstance(found.request, PlanRequest):
        raise MalformedRequest(
            f"run {run!r} judged a motion that was given: only a plan's execution is judged, so leave out --record, and"
            " give its --states to certify"
        )
    if isinstance(found.request, PlanRequest):
        for step in found.request.steps:
            if (thing := step.detach or (step.attach and step.attach.object)) is not None:
                raise MalformedRequest(
                    f"run {reply.run_id!r} picks up or puts down {thing!r}, and a controller of trajectories moves no"
                    " gripper: plan the steps up to there, and from there on, by themselves"
                )
    rows = reply.execution
    assert rows is not None, "else it is refused"
    message = trajectory_message(SentMotion(reply.run_id, reply.position_names, rows))
    times, places = _curve(rows)
    motion = MotionToExecute(tuple(reply.position_names), message, rows.tolerance, times, places)
    with controller_at(ros_connect, ros_domain, ros_controller, patience) as controller, _signals_interrupt():
        outcome = controller.follow(motion, typer.echo)
    typer.echo(f"{ros_controller}: {': '.join(one for one in (outcome.ended, outcome.reason) if one)}")
    if outcome.violations:
        time, joint, apart = max(outcome.violations, key=lambda one: one[2])
        typer.echo(
            f"{len(outcome.violations)} states were beyond the tolerance, {joint} by {apart:.3g} at {time:.3f} s"
        )
    if states is not None:
        _write_states(outcome.states, states)
    if record is not None and isinstance(reply, PlanReply) and isinstance(found.request, PlanRequest):
        engine = replaying_engine(owner_of(run), data_folder(data, name), ())
        judgement = engine.answer(judgement_of(found.request, reply, outcome.states), record_to=record)
        assert isinstance(judgement, CertifyReply), "the request is a certify request"
        Console().print(motion_table(judgement))
    raise typer.Exit(0 if outcome.is_fine else 1)


@contextlib.contextmanager
def _signals_interrupt() -> Iterator[None]:
    """Have the first signal that would end the process act as Ctrl-C, because the robot has to be stopped.

    A terminal that is closed, or systemd, sends a second one at once, which must not interrupt the cancelling.
    """
    deadly = [one for one in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(one) is signal.SIG_DFL]

    def interrupt(*_: object) -> None:
        for number in deadly:
            signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt

    for number in deadly:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number in deadly:
            signal.signal(number, signal.SIG_DFL)


def _curve(rows: ExecutionFigures) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n,) [s] and close samples, shape (n, k) [rad or m], of the curve that a controller follows."""
    import numpy as np  # it and the planner are loaded only here

    from guidefield.planner.motion.submitted_motion import SubmittedMotion

    times, positions = np.array(rows.times), np.array(rows.positions)
    if len(times) == 1:
        return np.repeat(times, 2), np.repeat(positions, 2, axis=0)
    rates = (None if one is None else np.array(one) for one in (rows.velocities, rows.accelerations))
    drawn = SubmittedMotion.through(times, positions, *rates).scheduled
    pieces = drawn.bezier()
    degree = pieces.shape[1] - 1
    bends = np.abs(np.diff(pieces, 2, axis=1)).max(axis=(1, 2), initial=0.0) * degree * (degree - 1) / 8.0
    parts = np.maximum(np.ceil(np.sqrt(bends / CHORD_TOLERANCE)), 1.0)
    knots = np.concatenate([[0.0], np.cumsum(parts)])
    moments = np.interp(np.arange(knots[-1] + 1.0), knots, times)
    return moments, np.array(drawn.evaluate(moments)[0])


def _write_states(states: JointStates, file: Path) -> None:
    rows = ([time, *row] for time, row in zip(states.times, states.positions, strict=True))
    file.write_bytes(write_table(["time", *states.joints], rows).encode())
