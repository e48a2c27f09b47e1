"""What a plan takes longer when its service is killed, and when it is asked for over ROS.

Usage: tools/bench service [--kills K | --ros] [--seconds S] [--workers N]

The service that plans for a client is killed in the middle of a plan while another instance is there: how much longer
the answer takes than that plan does alone. With --ros: what a plan takes beyond its own time over ROS, and the same
plan over our own key. `tools/bench door` measures what the service adds otherwise, and how many clients it serves.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import os
import struct
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import zenoh
from tests.journeys.service import LONG as WALLED

from guidefield import Client
from guidefield.cli.serving import ChildService, service_in_child
from guidefield.engine import Engine

if TYPE_CHECKING:
    from guidefield.endpoint.ros.cdr import Types

GOAL_FAILOVER, GOAL_ROS = 1.0, 2e-3
WARM = 3
"""Pairs of plans that don't count: the first load and prepare."""
LONG = {**WALLED, "allowed_planning_time": 1.0}
"""A plan that ends when its time of a second is up."""


def failover(kills: int) -> list[float]:
    """Of a plan whose service is killed in its middle: what its answer takes beyond the plan's own time [s]."""
    extra = []
    for _ in range(kills):
        with service_in_child(lambda _: None, name="a") as a, service_in_child(lambda _: None, name="b") as b:
            extra.append(_failed_over({"a": a, "b": b}))
    return extra


def _failed_over(services: dict[str, ChildService]) -> float:
    for service in services.values():
        with Client.connect(service.endpoint, wait=20.0) as client:
            client.plan(LONG)  # loads the robot
            start = time.perf_counter()
            client.plan(LONG)
            alone = time.perf_counter() - start
    with (
        concurrent.futures.ThreadPoolExecutor(1) as thread,
        Client.connect(*(service.endpoint for service in services.values()), wait=20.0) as client,
    ):
        first = client.instance
        answer = thread.submit(client.plan, LONG)
        time.sleep(alone / 2)
        services[first].process.kill()
        killed = time.perf_counter()
        answer.result()
        extra = time.perf_counter() - killed - alone
        assert client.instance != first, "nothing was killed that worked for the client"
        return extra


def processor_time(front: int) -> float:
    """What this process and a service without its workers, which only plan, took of the processors by now [s]."""
    return time.process_time() + time.clock_gettime(~front << 3 | 2)


def over_ros(seconds: float, workers: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What the same plan takes beyond its own time, over our own key and over ROS, asked in turn [s].

    Then what it takes of the processors here and in the service, its worker apart, the same two ways [s].
    """
    from guidefield.endpoint.ros.cdr import types_of
    from guidefield.endpoint.ros.motion_plan import asked_plan
    from guidefield.endpoint.ros.names import Entity, Kind
    from guidefield.endpoint.ros.options import Distribution
    from guidefield.endpoint.ros.snapshot import KnownRobot, Snapshot

    types, name = types_of(Distribution.JAZZY), "moveit_msgs/srv/GetMotionPlan"
    key = Entity(Kind.SERVICE, "plan_kinematic_path", name, types.type_hash(name)).key(0)
    text = "std_msgs/msg/String"
    plans = Entity(Kind.PUBLISHER, "guidefield/plans", text, types.type_hash(text)).key(0)
    asked = types.new(f"{name}_Request", motion_plan_request=_asked_over_ros(types))
    ours = asked_plan(asked, Snapshot(KnownRobot("panda", Engine().robot("panda")))).request
    payload, attachment = types.write(asked, f"{name}_Request"), struct.pack("<qqB16s", 1, 0, 16, bytes(16))
    own, ros, own_work, ros_work = [], [], [], []
    with (
        service_in_child(print, workers=workers, options=("--ros", "--ros-robot", "panda")) as service,
        Client.connect(service.endpoint, wait=20.0) as client,
        zenoh.open(_client_of(service.endpoint)) as session,
    ):
        told = session.declare_subscriber(plans)
        end = time.perf_counter() + seconds
        while time.perf_counter() < end or len(ros) < WARM + 5:
            start, work = time.perf_counter(), processor_time(service.process.pid)
            reply = client.plan(ours)
            own.append(time.perf_counter() - start - reply.timing.total)
            own_work.append(processor_time(service.process.pid) - work)
            start, work = time.perf_counter(), processor_time(service.process.pid)
            (answer,) = session.get(key, payload=payload, attachment=attachment, timeout=60.0)
            response = types.read(answer.ok.payload.to_bytes(), f"{name}_Response")
            elapsed = time.perf_counter() - start
            ros_work.append(processor_time(service.process.pid) - work)
            figures = json.loads(types.read(told.recv().payload.to_bytes(), text).data)
            ros.append(elapsed - figures["timing"]["total"])
            assert reply.status.code == response.motion_plan_response.error_code.val == 1
    return np.array(own[WARM:]), np.array(ros[WARM:]), np.array(own_work[WARM:]), np.array(ros_work[WARM:])


def _asked_over_ros(types: Types) -> Any:
    """A joint turns a little among nothing: a plan of milliseconds."""
    joint = types.new("moveit_msgs/msg/JointConstraint", joint_name="panda_joint1", position=0.05)
    goal = types.new("moveit_msgs/msg/Constraints", joint_constraints=[joint])
    return types.new(
        "moveit_msgs/msg/MotionPlanRequest", group_name="arm", allowed_planning_time=60.0, goal_constraints=[goal]
    )


def _client_of(endpoint: str) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return config


def _tell_ros(seconds: float, workers: int) -> None:
    own, ros, own_work, ros_work = over_ros(seconds, workers)
    for name, times in (("beyond a plan, our own key", own), ("beyond a plan, over ROS", ros)):
        print(f"{name:28s} {1e3 * np.median(times):8.2f} ms in the median of {len(times)}")
    extra, spread = float(np.median(ros - own)), np.quantile(ros - own, [0.25, 0.75])
    met = "met" if extra <= GOAL_ROS else "missed"
    print(f"{'overhead':28s} {1e3 * extra:8.2f} ms in the median of the pairs, half of them within")
    print(f"{'':28s} {1e3 * spread[0]:8.2f} to {1e3 * spread[1]:.2f} ms   goal {1e3 * GOAL_ROS:g} ms: {met}")
    work = np.median(own_work), np.median(ros_work), np.median(ros_work - own_work)
    print("of the processors, in the client and in the service without its worker, which other work doesn't change:")
    print(
        f"  own key {1e3 * work[0]:.2f} ms, over ROS {1e3 * work[1]:.2f} ms, {1e3 * work[2]:.2f} ms more in the pairs"
    )
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


def run(arguments: list[str]) -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(prog="tools/bench service")
    parser.add_argument("--seconds", type=float, default=5.0, help="over ROS")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--kills", type=int, default=5, help="services that are killed in the middle of a plan")
    parser.add_argument("--ros", action="store_true", help="plans over ROS instead")
    options = parser.parse_args(arguments)
    if options.ros:
        _tell_ros(options.seconds, options.workers)
        return
    extra = failover(options.kills)
    met = "met" if max(extra) <= GOAL_FAILOVER else "missed"
    late = f"{np.median(extra):.2f} s late in the median of {len(extra)}, {max(extra):.2f} s at most"
    print(f"its service killed, a plan comes from another one {late}   goal 1 s: {met}")
