"""`bounded`: what every class of parameters gets from its decorator."""

import pickle
from dataclasses import FrozenInstanceError, field, replace
from typing import Annotated

import pytest
from annotated_types import Gt, Le

from hardware_drivers.bounds import bounded


@bounded
class Window:
    """Two values with their own bounds, and a check of both."""

    start_s: Annotated[float, Gt(0.125)] = 1.0
    stop_s: Annotated[float, Le(10.25)] | None = None
    names: dict[str, str] = field(default_factory=dict)

    def __post_init__(self):
        if self.stop_s is not None and self.stop_s < self.start_s:
            raise ValueError(f"stop_s is {self.stop_s}; it must be at least start_s = {self.start_s}")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"start_s": 0.0}, "start_s is 0.0; it must be greater than 0.125"),
        ({"stop_s": 10.5}, "stop_s is 10.5; it must be at most 10.25"),
        ({"start_s": float("nan")}, "start_s is nan; it must be a finite number"),
        ({"start_s": -2.0, "stop_s": -3.0}, "start_s is -2.0; it must be greater than 0.125"),
        ({"start_s": 3.0, "stop_s": 2.0}, "stop_s is 2.0; it must be at least start_s = 3.0"),
    ],
)
def test_bounds_are_checked_before_what_only_the_class_knows(values, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        Window(**values)
    with pytest.raises(ValueError, match=f"^{message}$"):
        replace(Window(), **values)


def test_an_absent_value_has_no_bound():
    assert Window().stop_s is None


def test_parameters_are_frozen_have_slots_and_take_keywords_only():
    window = Window(stop_s=2.0)
    with pytest.raises(FrozenInstanceError):
        window.start_s = 2.0
    assert not hasattr(window, "__dict__")
    with pytest.raises(TypeError, match="positional"):
        Window(1.0)


def test_parameters_can_be_sent_to_another_process():
    window = Window(start_s=2.0, names={"a": "b"})
    assert pickle.loads(pickle.dumps(window)) == window


def test_a_class_forbids_unknown_keys():
    assert Window.__pydantic_config__ == {"extra": "forbid"}
