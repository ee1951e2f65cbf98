"""Delivery by e-mail, chat and other services of the package apprise, imported only if configured."""

from __future__ import annotations

import logging
import os

from daq_service.processes.notifications.addresses import Address
from daq_service.processes.notifications.messages import Message
from daq_service.processes.notifications.webhook import Outcome


def deliver_by_apprise(address: Address, message: Message) -> Outcome:
    """Try once to deliver a message and return the outcome; apprise limits the time of its connections.

    Its log may repeat parts of an address and is disabled, so a failure is reported without its cause. Also
    disables .netrc for this process. Exceptions of apprise pass through.
    """
    import apprise

    # The package requests would lend a receiver the passwords of a .netrc.
    os.environ["NETRC"] = os.devnull
    logging.getLogger("apprise").setLevel(logging.CRITICAL + 1)
    # Synchronous: the thread belongs to the receiver.
    client = apprise.Apprise(asset=apprise.AppriseAsset(async_mode=False))
    if not client.add(address.url):
        return Outcome(
            ok=False, description="apprise does not know this kind of address; see its list of services"
        )
    kind = apprise.NotifyType.WARNING if message.kind == "alarm" else apprise.NotifyType.INFO
    if client.notify(title=message.title, body=f"{message.text}\n\n{message.key}", notify_type=kind):
        return Outcome(ok=True, description="handed over")
    return Outcome(
        ok=False, description="apprise could not deliver it: see host, name and password in the address"
    )
