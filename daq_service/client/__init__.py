"""Client that reads a test in Python, from its folder or its service, with units and quality.

>>> from daq_service import client
>>> with client.open("my-test-data") as test:
...     features = test.features("B")
"""

from __future__ import annotations

import os
from pathlib import Path

from daq_service.processes.installation import require_extras

require_extras("client")  # before the modules that import its packages
from daq_service.client.errors import ClientError, RefusedError, UnreachableError  # noqa: E402
from daq_service.client.experiment import Event, Experiment  # noqa: E402

__all__ = ["ClientError", "Event", "Experiment", "RefusedError", "UnreachableError", "open"]

TOKEN_VARIABLE = "SOLIMON_TOKEN"
TIMEOUT_S = 60.0
"""Longer than the interval of the stream's heartbeat: only a dead connection is silent for longer."""


def open(where: str | Path, *, token: str | None = None, timeout_s: float = TIMEOUT_S) -> Experiment:  # noqa: A001 - read as client.open
    """Open a test for reading; close it with ``close()`` or a with statement.

    Parameters
    ----------
    where
        Its data folder, or the address of its service, such as ``http://127.0.0.1:8750``.
    token
        Access token of a service; default: the environment's ``SOLIMON_TOKEN``. A folder needs none.
    timeout_s
        Time limit of every answer of a service, in s. No request is sent yet.

    Raises
    ------
    StorageError
        The folder holds no test yet, or cannot be read.
    ClientError
        The address is invalid, or a variable of the environment that concerns it (``HTTP_PROXY``,
        ``HTTPS_PROXY``, ``ALL_PROXY``, ``SSL_CERT_FILE``, ``SSL_CERT_DIR``) cannot be used. Addresses of this
        computer are requested without a proxy.
    """
    if not str(where).startswith(("http://", "https://")):
        from daq_service.client.in_process import open_folder_connection

        return Experiment(open_folder_connection(Path(where)))
    from daq_service.client.connection import Connection
    from daq_service.client.transport import create_http_client

    access_token = token or os.environ.get(TOKEN_VARIABLE)
    headers = {"Authorization": f"Bearer {access_token}"} if access_token else {}
    return Experiment(Connection(create_http_client(str(where), headers=headers, timeout_s=timeout_s)))
