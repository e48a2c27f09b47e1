"""Links that end while large answers are being sent to them, of clients that don't read any more."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

from guidefield.endpoint.link import LEASE
from tests.journeys.service import plain_client, running_service

COUNT, EACH = 8, 3
"""More links than Zenoh has threads that send where it isn't told, and more answers for each than a link holds."""
ENDED_AFTER = LEASE + 3.0  # by then a link has ended whose client was stopped [s]
PATIENT = {
    "transport": {"link": {"tx": {"queue": {"congestion_control": {"block": {"wait_before_close": 600_000_000}}}}}}
}
"""A service that waits for readers for ten minutes: what is held up until then is held up for the whole test."""
MANY = """
import json, sys, threading, zenoh
ball = {"name": "s", "obstacles": [{"type": "sphere", "name": "b", "radius": 0.1}]}
asked = json.dumps({"type": "potential", "scene": ball, "points": [[0.1, 0.0, 2.0]] * 50_000})
kept = []
for _ in range(int(sys.argv[2])):
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    kept.append(session)
    for _ in range(int(sys.argv[3])):
        session.get("guidefield/local/kinematics", lambda reply: None, payload=asked, timeout=600.0)
print("asked", flush=True)
threading.Event().wait()
"""


def test_links_that_end_while_they_are_sent_to_hold_up_no_other(tmp_path: Path) -> None:
    config = tmp_path / "patient.json5"
    config.write_text(json.dumps(PATIENT), encoding="utf-8")
    with (
        running_service(tmp_path / "data", "--workers", "1", "--config", str(config)) as service,
        plain_client(service.endpoint) as client,
        subprocess.Popen(
            [sys.executable, "-c", MANY, service.endpoint, str(COUNT), str(EACH)], stdout=subprocess.PIPE, text=True
        ) as stopped,
    ):
        try:
            assert stopped.stdout.readline() == "asked\n"
            stopped.send_signal(signal.SIGSTOP)
            until = time.monotonic() + ENDED_AFTER
            while time.monotonic() < until:
                assert client.ask("guidefield/local/robots")
                time.sleep(0.1)
        finally:
            stopped.kill()
