"""Two hosts in network namespaces: the link between them is cut in the middle of a plan, and healed.

Usage: tools/attack link

Needs root, `ip` and leave to make network namespaces; ends with a reason and exit code 0 where they are missing. A
service runs on one host, a client on the other. The link is cut while the service plans: the client must hear of it
within Zenoh's lease and some, and never twice. After the link is healed the same client must be answered again.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time

from tests.journeys.service import LONG

NEAR, FAR = "guidefield-near", "guidefield-far"
ENDPOINT = "tcp/10.77.0.2:7447"
HEARD_WITHIN = 25.0
"""Longest time between the cut and the client's hearing of it: its lease, a search for another, and room [s]."""

CLIENT = """
import json, sys, time
from guidefield import Client, GuidefieldError, NoService
request = json.loads(sys.argv[1])
with Client.connect("{endpoint}", wait=60.0) as client:
    print("connected", flush=True)
    try:
        print("answer", client.plan(request).status.name, flush=True)
    except NoService as gone:
        print("gone", flush=True)
    sys.stdin.readline()
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        try:
            print("again", client.info().workers, flush=True)
            break
        except GuidefieldError:
            time.sleep(0.2)
"""
REQUEST = {**LONG, "allowed_planning_time": 60.0}


def ip(*arguments: str) -> None:
    """Run `ip`."""
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


def inside(host: str, *command: str) -> list[str]:
    """A command on a host."""
    return ["ip", "netns", "exec", host, *command]


def make_hosts() -> None:
    """Two hosts with a link between them."""
    for host in (NEAR, FAR):
        ip("netns", "add", host)
        ip("-n", host, "link", "set", "lo", "up")
    ip("-n", NEAR, "link", "add", "veth0", "type", "veth", "peer", "name", "veth0", "netns", FAR)
    for host, address in ((NEAR, "10.77.0.1/24"), (FAR, "10.77.0.2/24")):
        ip("-n", host, "addr", "add", address, "dev", "veth0")
        ip("-n", host, "link", "set", "veth0", "up")


def remove_hosts() -> None:
    """Leave nothing behind."""
    for host in (NEAR, FAR):
        subprocess.run(["ip", "netns", "delete", host], check=False, capture_output=True)


def run(arguments: list[str]) -> int:
    """Cut and heal, and say how it went."""
    argparse.ArgumentParser(prog="tools/attack link", description=__doc__).parse_args(arguments)
    if os.geteuid() != 0 or shutil.which("ip") is None:
        print("skipped: needs root and `ip` (iproute2)")
        return 0
    try:
        make_hosts()
    except subprocess.CalledProcessError as error:
        print(f"skipped: network namespaces are not permitted here: {error.stderr.decode().strip()}")
        remove_hosts()
        return 0
    try:
        with tempfile.TemporaryDirectory() as data:
            return cut_and_heal(data)
    finally:
        remove_hosts()


def cut_and_heal(data: str) -> int:
    """Have a plan made, cut the link in the middle, heal it, and ask again."""
    serve = [sys.executable, "-m", "guidefield", "serve", "--listen", ENDPOINT, "--workers", "1", "--data", data]
    ask = [sys.executable, "-c", CLIENT.format(endpoint=ENDPOINT), json.dumps(REQUEST)]
    with subprocess.Popen(inside(FAR, *serve), stdout=subprocess.PIPE, text=True) as service:
        assert any(line.startswith("ready") for line in service.stdout), "the service did not start"
        with subprocess.Popen(inside(NEAR, *ask), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as client:
            heard: list[str] = []
            reader = threading.Thread(target=lambda: heard.extend(line.strip() for line in client.stdout))
            assert client.stdout.readline().strip() == "connected"
            time.sleep(1.5)
            ip("-n", FAR, "link", "set", "veth0", "down")
            cut = time.monotonic()
            reader.start()
            while not heard and time.monotonic() - cut < 90.0:
                time.sleep(0.01)
            told = time.monotonic() - cut
            print(f"the client heard {heard} {told:.1f} s after the cut")
            ip("-n", FAR, "link", "set", "veth0", "up")
            healed = time.monotonic()
            client.stdin.write("\n")
            client.stdin.flush()
            reader.join(90.0)
            print(f"then {heard[1:]}, {time.monotonic() - healed:.1f} s after the link was healed")
        service.terminate()
        service.wait(60.0)
    return int(heard != ["gone", "again 1"] or told > HEARD_WITHIN)
