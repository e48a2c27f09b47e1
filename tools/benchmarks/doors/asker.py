"""A client process that asks one query after the other, as it is told on standard input; a line of JSON for each order.

An order has the endpoint, the key, the payload, how many queries or for how many seconds, and the time of the monotonic
clock at which to begin. The answer has the time that each query took, and the number and the first of the errors.
"""

import json
import sys
import time

import zenoh

TIMEOUT = 120.0
sessions: dict[str, zenoh.Session] = {}


def open_session(endpoint: str) -> zenoh.Session:
    """Return the session with an endpoint; it is opened at the first use."""
    if endpoint not in sessions:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        sessions[endpoint] = zenoh.open(config)
    return sessions[endpoint]


def ask(session: zenoh.Session, key: str, payload: str | None) -> str | None:
    """Ask once; return the error, if that is the answer."""
    replies = list(session.get(key, payload=payload, timeout=TIMEOUT))
    if len(replies) != 1:
        return f"{len(replies)} replies"
    reply = replies[0]
    return None if reply.ok is not None else reply.err.payload.to_bytes().decode()


for line in sys.stdin:
    order = json.loads(line)
    session = open_session(order["endpoint"])
    times, errors = [], []
    time.sleep(max(0.0, order["begin"] - time.monotonic()))
    until = time.monotonic() + order.get("seconds", TIMEOUT)
    while len(times) + len(errors) < order.get("count", 10**9) and (began := time.monotonic()) < until:
        error = ask(session, order["key"], order["payload"])
        if error is None:
            times.append(time.monotonic() - began)
        else:
            errors.append(error)
    print(json.dumps({"times": times, "errors": len(errors), "first_error": errors[:1]}), flush=True)
for session in sessions.values():
    session.close()
