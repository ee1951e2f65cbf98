"""E-mail, chat and what else the package apprise reaches; imported only where a receiver asks for it."""

from __future__ import annotations

import logging
import os

from daq_service.processes.notifications.addresses import Address
from daq_service.processes.notifications.messages import Message
from daq_service.processes.notifications.webhook import Outcome


def notify(address: Address, message: Message) -> Outcome:
    """Try once to deliver a message; apprise bounds its own connections in time.

    Its own log may repeat parts of an address and is kept silent, so a failure is told without its cause.
    """
    import apprise

    # The package requests would lend a receiver the passwords of a .netrc.
    os.environ["NETRC"] = os.devnull
    logging.getLogger("apprise").setLevel(logging.CRITICAL + 1)
    # In this thread, which is the receiver's own.
    door = apprise.Apprise(asset=apprise.AppriseAsset(async_mode=False))
    if not door.add(address.url):
        return Outcome(ok=False, told="apprise does not know this kind of address; see its list of services")
    kind = apprise.NotifyType.WARNING if message.kind == "alarm" else apprise.NotifyType.INFO
    if door.notify(title=message.title, body=f"{message.text}\n\n{message.key}", notify_type=kind):
        return Outcome(ok=True, told="handed over")
    return Outcome(ok=False, told="apprise could not deliver it: see host, name and password in the address")
