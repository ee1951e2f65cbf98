"""Reading and setting of attributes of any family."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

from simulator.doubles.daqmx.tasks import Answer, Arguments, Task, TaskState
from simulator.doubles.vendor_api import statuses
from simulator.doubles.vendor_api.attributes import ATTRIBUTES, Attribute
from simulator.doubles.vendor_api.statuses import Status

Subject = TypeVar("Subject")


def _find_attribute(arguments: Arguments, family: str) -> Attribute:
    """Return the attribute whose number a call names; raise Status if its family has no such attribute."""
    found = ATTRIBUTES.get(arguments["attribute"])
    if found is None or found.family != family:
        raise Status(
            statuses.NO_SUCH_ATTRIBUTE, f"The double has no {family} attribute {arguments['attribute']:#x}."
        )
    return found


def answer_attribute(
    values: Mapping[str, Callable[[Subject], object]], arguments: Arguments, family: str, subject: Subject
) -> Answer:
    """Answer a call with the value of an attribute; raise Status if the family or ``values`` lacks it.

    Parameters
    ----------
    values
        Attribute name to the function that returns its value; its Status is raised, too.
    family
        Family of attributes of the entry point, such as ``Timing``.
    subject
        Argument of these functions: bench, board, channel or task.
    """
    name = _find_attribute(arguments, family).name
    if name not in values:
        raise Status(statuses.ATTRIBUTE_NOT_SUPPORTED, f"Property: {name}")
    return {"value": values[name](subject)}


def require_settable(task: Task, arguments: Arguments, family: str) -> str:
    """Return the name of the attribute that a call sets.

    Raise Status if it is unknown or read-only, or the task runs.
    """
    attribute = _find_attribute(arguments, family)
    if not attribute.settable:
        raise Status(statuses.ATTRIBUTE_NOT_SETTABLE, f"Property: {attribute.name}", task=task.name)
    if task.state is TaskState.RUNNING:
        raise Status(statuses.PROPERTY_WHILE_RUNNING, f"Property: {attribute.name}", task=task.name)
    return attribute.name
