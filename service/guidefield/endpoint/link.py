"""How the service's links are set where its configuration leaves Zenoh's own, and Zenoh's threads."""

from __future__ import annotations

from guidefield.messages import codec
from guidefield.pool.outbox import MOST_THREADS

READ_WITHIN = 15.0
"""How long an answer may take to be read, beside what the system keeps of it, before its link is ended [s]."""
LEASE = 10.0
"""How long a link that was cut without a word may go unnoticed [s].

It is Zenoh's own: with 2 s a service that got hardly any of a busy machine lost its links, and with them the answers.
"""
LONGEST_MESSAGE = 4 * codec.MAX_REQUEST_BYTES
"""Zenoh drops a larger message without a word [bytes]; what is between this and a payload's limit is refused."""
RUNTIME = (
    f"(rx: (worker_threads: 32), tx: (worker_threads: {MOST_THREADS + 4}), "
    "net: (worker_threads: 4), app: (worker_threads: 4))"
)
"""Zenoh's threads, unless the variable ZENOH_RUNTIME says otherwise.

Where a link ends to which an answer is being sent, Zenoh blocks one of the threads that send until the answer's own
thread gives up, for up to `READ_WITHIN`. So there are more of them than answers are sent at once; of four, Zenoh's own
number, four stopped clients would keep every other link's answers waiting. Those that receive call the endpoint: of
four, six links that flood it would keep the others' queries waiting three times as long.
"""
UNLESS_TOLD = {
    "scouting/multicast/enabled": "false",
    "scouting/gossip/enabled": "false",
    "transport/link/tx/lease": f"{1e3 * LEASE:.0f}",  # [ms]
    "transport/link/tx/queue/congestion_control/block/wait_before_close": f"{1e6 * READ_WITHIN:.0f}",  # [us]
    "transport/link/rx/max_message_size": str(LONGEST_MESSAGE),
}
"""What holds where the configuration leaves Zenoh's own: nobody is looked for, and nothing is read without end."""
