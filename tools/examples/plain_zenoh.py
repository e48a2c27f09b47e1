"""A plan over plain Zenoh and JSON, with nothing of guidefield installed: what a client in any language does.

    pip install eclipse-zenoh
    python plain_zenoh.py tcp/127.0.0.1:7447

1. A service is found by its liveliness token, `guidefield/<instance>/alive`.
2. A query with JSON on `guidefield/<instance>/plan` is the request. Its attachment is a name that this client gives
   itself: the queue is fair between those who have one.
3. How far the run is comes on `guidefield/<instance>/runs/<run_id>/progress`; a query on `../cancel` would end it.
4. There is exactly one answer: a reply (of a plan that was found, or of one that was tried and not found), or an error
   with `code`, `name`, `message` and `details`. No answer at all means that the service is gone: ask another instance.
5. The query's own time-out is longer than the planning time, so that the service has the last word.
6. The trajectory is the cubic Hermite curve through times, positions and velocities; the recording is a file for the
   Rerun viewer.
"""

import json
import sys
import uuid
from pathlib import Path

import zenoh

ENDPOINT = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
RECORDING = Path(sys.argv[2] if len(sys.argv) > 2 else "plain_zenoh.rrd")
PLANNING_TIME = 60.0

REQUEST = {
    "run_id": uuid.uuid4().hex,
    "robot": "panda",
    "scene": {
        "name": "post",
        "obstacles": [{"type": "cylinder", "name": "post", "radius": 0.05, "length": 1.0, "position": [0.45, 0, 0.5]}],
    },
    "start": {"panda_joint1": -0.8, "panda_joint2": 0.2, "panda_joint4": -1.8, "panda_joint6": 2.0},
    "goal": {
        "type": "joints",
        "positions": {"panda_joint1": 0.8, "panda_joint2": 0.2, "panda_joint4": -1.8, "panda_joint6": 2.0},
    },
    "guide_planes": [],
    "allowed_planning_time": PLANNING_TIME,
}


def at(trajectory, time):
    """Positions at a time: the cubic Hermite curve, which is what was certified."""
    times, positions, velocities = trajectory["times"], trajectory["positions"], trajectory["velocities"]
    i = max(k for k in range(len(times) - 1) if times[k] <= time)
    h = times[i + 1] - times[i]
    s = (time - times[i]) / h
    a, b, c, d = 2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s, 3 * s**2 - 2 * s**3, s**3 - s**2
    rows = zip(positions[i], velocities[i], positions[i + 1], velocities[i + 1], strict=True)
    return [a * p0 + b * h * v0 + c * p1 + d * h * v1 for p0, v0, p1, v1 in rows]


def ask(session, key, request=None, timeout=10.0):
    """The payload of the one answer; ends the program where it is an error, or where there is none."""
    payload = None if request is None else json.dumps(request)
    for answer in session.get(
        key, payload=payload, encoding="application/json", attachment="plain_zenoh.py", timeout=timeout
    ):
        if answer.ok is not None:
            return answer.ok.payload.to_bytes()
        words = answer.err.payload.to_string()
        if words == "Timeout":  # Zenoh's own, in words
            sys.exit("the service took too long")
        error = json.loads(words)
        sys.exit(f"{error['name']} ({error['code']}): {error['message']}")
    sys.exit("the service is gone")


def main():
    """Find a service, plan, and fetch the recording."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([ENDPOINT]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        alive = [str(token.ok.key_expr) for token in session.liveliness().get("guidefield/*/alive", timeout=5.0)]
        if not alive:
            sys.exit(f"no service at {ENDPOINT}")
        service = alive[0].removesuffix("/alive")
        run = f"{service}/runs/{REQUEST['run_id']}"

        def tell(sample):
            progress = json.loads(sample.payload.to_bytes())
            print(f"{progress['elapsed']:.2f} s: {progress['stage']}")

        watched = session.declare_subscriber(f"{run}/progress", tell)
        reply = json.loads(ask(session, f"{service}/plan", REQUEST, timeout=PLANNING_TIME + 90.0))
        watched.undeclare()
        print(f"{reply['status']['name']}: {reply['status']['message']}")
        if reply["status"]["code"] != 1:
            sys.exit(1)
        trajectory = reply["trajectory"]
        middle = at(trajectory, 0.5 * trajectory["times"][-1])
        print(f"{trajectory['times'][-1]:.2f} s long, {1e3 * reply['clearance']['minimum']:.1f} mm from the post")
        print("half-way:", dict(zip(reply["position_names"], [round(q, 3) for q in middle], strict=True)))
        RECORDING.write_bytes(ask(session, reply["recording"], timeout=60.0))
        print(f"recorded in {RECORDING}")


if __name__ == "__main__":
    main()
