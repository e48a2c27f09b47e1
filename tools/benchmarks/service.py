"""What the service adds to an answer, and how many clients it serves: the wire against the same engine in this process.

Usage: tools/bench service [--seconds S] [--workers N] [--kills K]

A request of 1 kB (the potential at points near a ball) is answered in this process and over a service on loopback, in
turn; the overhead is the difference. Then 1, 8 and 64 clients, each with a session of its own, ask as fast as they can.
Last, the process that plans for a client is killed in the middle of a plan while another instance is there: how much
longer the answer takes than that plan does alone.
"""

from __future__ import annotations

import argparse
import asyncio
import concurrent.futures
import os
import time

import numpy as np

from guidefield import AsyncClient, Box, Client, JointsGoal, PlanRequest, Potential, Scene, Sphere
from guidefield.cli.serving import ChildService, service_in_child
from guidefield.engine import Engine
from guidefield.messages import codec

CLIENTS = (1, 8, 64)
GOAL_P50, GOAL_P99, GOAL_FAILOVER = 1e-3, 10e-3, 1.0


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


def run(arguments: list[str]) -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(prog="tools/bench service")
    parser.add_argument("--seconds", type=float, default=5.0, help="of each measurement")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--kills", type=int, default=5, help="services that are killed in the middle of a plan")
    options = parser.parse_args(arguments)
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
