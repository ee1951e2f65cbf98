"""Lock of a client name: one process of this computer for each name on a gRPC server.

Tasks on the server are distinguished by that name, so a second process under it would clear the first
one's. The lock is the operating system's: it ends with its process, however that ends.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from pathlib import Path
from typing import IO

from hardware_drivers.errors import BusyError


class ClientLock:
    """Hold a client name until `release`.

    Raises
    ------
    BusyError
        Another process holds it.
    """

    def __init__(self, address: str, client: str) -> None:
        """Lock the file of a client name on a server (HOST:PORT) without waiting.

        The file is in the temporary folder; this process's number is written to it.
        """
        key = hashlib.sha256(f"{address} {client}".encode()).hexdigest()[:16]
        path = Path(tempfile.gettempdir()) / f"solimon-daqmx-{key}.lock"
        refusal = (
            f"another process of this computer already uses the gRPC server {address} under the name "
            f"{client!r}; end it, or set grpc_client_name in [rig.daqmx]"
        )
        try:
            self._file: IO[bytes] | None = path.open("a+b")
        except OSError as error:  # another user's process made it
            raise BusyError(f"{refusal} (owner: {path}: {error})") from error
        try:
            _lock_first_byte(self._file)
        except OSError as error:
            self._file.seek(1)
            owner = self._file.read().decode(errors="replace") or "unknown"
            self._file.close()
            raise BusyError(f"{refusal} (owner: process {owner})") from error
        self._file.seek(0)
        self._file.truncate()
        # The first byte is the one that is locked: on Windows it cannot be read meanwhile.
        self._file.write(b" " + str(os.getpid()).encode())
        self._file.flush()

    def release(self) -> None:
        """Release the client name by closing the lock file, which is kept; repeated calls have no effect."""
        file, self._file = self._file, None
        if file is not None:
            file.close()


def _lock_first_byte(file: IO[bytes]) -> None:
    """Lock a file (Windows: its first byte) for this process without waiting; OSError if it is locked."""
    if sys.platform == "win32":
        import msvcrt

        file.seek(0)
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
