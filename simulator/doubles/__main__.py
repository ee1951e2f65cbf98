"""``python -m simulator.doubles``: one double as a process of its own.

It prints one JSON line when it is ready and ends when its standard input closes, so it never outlives
whoever started it.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

try:
    from simulator.doubles.chassis.description import build_default_description, read_description
    from simulator.doubles.device_model import Brain
    from simulator.doubles.transports.control_server import ControlServer
    from simulator.doubles.transports.grpc_front import GrpcFront, find_unavailability_reason
    from simulator.doubles.transports.server import WireServer
except ModuleNotFoundError as error:
    sys.exit(f'the doubles run the twin; {error}: pip install "solimon[twin]"')


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the doubles until standard input closes, then end the process with exit code 0.

    It prints one JSON line with the addresses when it is ready. Unless ``--no-warm-up`` is given, one shot
    per position is computed before.
    """
    parser = argparse.ArgumentParser(prog="python -m simulator.doubles", description=__doc__)
    parser.add_argument("--description", type=Path, help="JSON file; absent: the four default boards")
    parser.add_argument("--no-warm-up", action="store_true", help="be ready before the physics is")
    chosen = parser.parse_args(arguments)
    logging.basicConfig(level=logging.WARNING, stream=sys.stderr)

    description = read_description(chosen.description) if chosen.description else build_default_description()
    brain = Brain(description)
    if not chosen.no_warm_up:
        brain.bench.strikes.warm_up()
    with WireServer(brain) as wire, ControlServer(brain) as control:
        for server in (wire, control):
            threading.Thread(target=server.serve_forever, daemon=True).start()
        # Kept: a gRPC server ends with its last reference.
        front = _start_grpc_front(brain)
        ready = json.dumps(
            {
                "event": "ready",
                "wire": wire.address,
                "control": control.address,
                "grpc": "" if front is None else front.address,
            }
        )
        print(ready, flush=True)
        sys.stdin.buffer.read()
        # Calls may hang on order; their threads must not keep the process.
        sys.stdout.flush()
        os._exit(0)


def _start_grpc_front(brain: Brain) -> GrpcFront | None:
    """Start the gRPC server and return it; None, with a logged warning, if gRPC is not installed.

    Raise DoublesError if it cannot listen.
    """
    reason = find_unavailability_reason()
    if reason:
        logging.getLogger(__name__).warning("no gRPC front: %s", reason)
        return None
    client = brain.open_client("grpc", "server")
    return GrpcFront(lambda function, arguments: brain.call(client, function, arguments))


if __name__ == "__main__":
    sys.exit(main())
