"""What the service adds to an answer, and how many clients it serves: the wire against the same engine in this process.

Usage: tools/bench service [--seconds S] [--workers N] [--kills K] [--ros]

A request of 1 kB (the potential at points near a ball) is answered in this process and over a service on loopback, in
turn; the overhead is the difference. Then 1, 8 and 64 clients, each with a session of its own, ask as fast as they can.
Last, the process that plans for a client is killed in the middle of a plan while another instance is there: how much
longer the answer takes than that plan does alone. With --ros instead: what a plan takes
beyond its own time over ROS, and the same plan over our own key.
"""

from __future__ import annotations

import argparse
import asyncio
import concurrent.futures
import json
import os
import struct
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import zenoh

from guidefield import AsyncClient, Box, Client, JointsGoal, PlanRequest, Potential, Scene, Sphere
from guidefield.cli.serving import ChildService, service_in_child
from guidefield.engine import Engine
from guidefield.messages import codec

if TYPE_CHECKING:
    from guidefield.endpoint.ros.cdr import Types

CLIENTS = (1, 8, 64)
GOAL_P50, GOAL_P99, GOAL_FAILOVER, GOAL_ROS = 1e-3, 10e-3, 1.0, 2e-3
WARM = 3
"""Pairs of plans that don't count: the first load and prepare."""


def request_of_1_kb() -> Potential:
    """The potential at so many points that the request takes 1 kB as MessagePack."""
    scene = Scene("ball", obstacles=[Sphere(name="s", radius=0.1)])
    points: list[tuple[float, float, float]] = []
    rng = np.random.default_rng(0)
    while len(codec.encode(Potential(scene=scene, points=points), codec.Encoding.MSGPACK)) < 1000:
        x, y, z = rng.uniform(0.5, 1.5, 3).tolist()
        points.append((x, y, z))
    return Potential(scene=scene, points=points)


def overhead(client: Client, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Times of the same answer in this process and over the wire, asked in turn [s]."""
    engine, request = Engine(), request_of_1_kb()
    here, there = [], []
    for _ in range(50):
        engine.answer(codec.decode_request(codec.encode(request)))
        client.kinematics(request)
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        codec.encode(engine.answer(request), codec.Encoding.MSGPACK)
        middle = time.perf_counter()
        client.kinematics(request)
        there.append(time.perf_counter() - middle)
        here.append(middle - start)
    return np.array(here), np.array(there)


async def throughput(endpoint: str, clients: int, seconds: float) -> tuple[float, np.ndarray]:
    """Answers per second to so many clients, and the time of each [s]."""
    request = request_of_1_kb()
    sessions = await asyncio.gather(*(AsyncClient.connect(endpoint, wait=20.0) for _ in range(clients)))
    times: list[float] = []
    begin = time.perf_counter()

    async def ask(client: AsyncClient) -> None:
        while time.perf_counter() < begin + seconds:
            start = time.perf_counter()
            await client.kinematics(request)
            times.append(time.perf_counter() - start)

    await asyncio.gather(*(ask(client) for client in sessions))
    rate = len(times) / (time.perf_counter() - begin)
    await asyncio.gather(*(client.close() for client in sessions))
    return rate, np.array(times)


def request_of_a_second() -> PlanRequest:
    """A plan that ends when its time of a second is up: the goal is behind walls that shut the start in."""
    walls = [
        Box(name="front", size=(1.4, 0.02, 1.0), position=(0.845, 0.0, 0.7)),
        Box(name="back", size=(1.4, 0.02, 1.0), position=(-0.845, 0.0, 0.7)),
        Box(name="lid", size=(3.0, 0.02, 1.0), position=(0.0, 0.0, 1.18)),
    ]
    bent = {"panda_joint2": 0.6, "panda_joint4": -1.2, "panda_joint6": 1.8}
    return PlanRequest(
        robot="panda",
        scene=Scene("walled", obstacles=walls),
        start={**bent, "panda_joint1": 1.5708},
        goal=JointsGoal(positions={**bent, "panda_joint1": -1.5708}),
        guide_planes=[],
        planner="tree",
        allowed_planning_time=1.0,
        recording="off",
    )


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
            client.plan(request_of_a_second())  # loads the robot
            start = time.perf_counter()
            client.plan(request_of_a_second())
            alone = time.perf_counter() - start
    with (
        concurrent.futures.ThreadPoolExecutor(1) as thread,
        Client.connect(*(service.endpoint for service in services.values()), wait=20.0) as client,
    ):
        first = client.instance
        answer = thread.submit(client.plan, request_of_a_second())
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
    parser.add_argument("--seconds", type=float, default=5.0, help="of each measurement")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--kills", type=int, default=5, help="services that are killed in the middle of a plan")
    parser.add_argument("--ros", action="store_true", help="plans over ROS instead")
    options = parser.parse_args(arguments)
    if options.ros:
        _tell_ros(options.seconds, options.workers)
        return
    with service_in_child(print, workers=options.workers) as service:
        with Client.connect(service.endpoint, wait=20.0) as client:
            here, there = overhead(client, options.seconds)
        print(f"\n1 kB requests, {len(there)} of them    p50        p99")
        for name, times in (("in this process", here), ("over the wire", there)):
            print(f"{name:28s} {1e3 * np.quantile(times, 0.5):7.3f} ms {1e3 * np.quantile(times, 0.99):8.3f} ms")
        p50, p99 = (np.quantile(there, q) - np.quantile(here, q) for q in (0.5, 0.99))
        met = "met" if p50 <= GOAL_P50 and p99 <= GOAL_P99 else "missed"
        print(f"{'overhead':28s} {1e3 * p50:7.3f} ms {1e3 * p99:8.3f} ms   goal 1 ms, 10 ms: {met}")
        print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n")
        for clients in CLIENTS:
            rate, times = asyncio.run(throughput(service.endpoint, clients, options.seconds))
            p50, p99 = 1e3 * np.quantile(times, 0.5), 1e3 * np.quantile(times, 0.99)
            print(f"{clients:3d} clients: {rate:7.0f} answers/s, each in p50 {p50:.2f} ms, p99 {p99:.2f} ms")
    if options.kills:
        extra = failover(options.kills)
        met = "met" if max(extra) <= GOAL_FAILOVER else "missed"
        late = f"{np.median(extra):.2f} s late in the median of {len(extra)}, {max(extra):.2f} s at most"
        print(f"\nits service killed, a plan comes from another one {late}   goal 1 s: {met}")
