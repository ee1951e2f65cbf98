"""Functions that refuse some of their calls, as a locked database or a full disk does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest


def refuse(
    monkeypatch: pytest.MonkeyPatch,
    owner: Any,
    name: str,
    error: Exception,
    *,
    times: int,
    when: Callable[..., bool] = lambda *arguments, **named: True,
    before: Callable[..., object] = lambda *arguments, **named: None,
) -> Iterator[bool]:
    """Let the next calls of a function fail; return an iterator over the refusals that are left.

    Parameters
    ----------
    when
        Which calls are refused, by their arguments.
    before
        What a refused call does all the same.
    """
    call, left = getattr(owner, name), iter([True] * times)

    def refusing(*arguments: Any, **named: Any) -> Any:
        if when(*arguments, **named) and next(left, False):
            before(*arguments, **named)
            raise error
        return call(*arguments, **named)

    monkeypatch.setattr(owner, name, refusing)
    return left
