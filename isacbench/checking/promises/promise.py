"""Promises: properties with a bound, measured on a plugin together with its input."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

HARMLESS = (DeprecationWarning, PendingDeprecationWarning, ResourceWarning, ImportWarning)
"""Warnings about outdated libraries: no plugin fails because of them."""

Subject = TypeVar("Subject")
Result = TypeVar("Result")


class BrokenPromiseError(Exception):
    """A plugin breaks a promise; the message says how, and how to mend it."""


class NotApplicableError(Exception):
    """A promise says nothing about this plugin or this input; the message says why."""


@dataclass(frozen=True)
class Promise(Generic[Subject]):
    """Property that a plugin must have.

    Attributes
    ----------
    bound : float
        Largest drift that is allowed.
    drift : callable
        Takes the subject and returns its distance from what is promised, 0
        for a property without a distance. Raises `BrokenPromiseError` where
        no number says it. Every other exception breaks the promise as well.
    hint : str
        How to mend it.
    """

    name: str
    bound: float
    drift: Callable[[Subject], float]
    hint: str = ""

    def complaint(self, drift: float) -> str:
        """Describe a drift that is too large.

        Returns
        -------
        str
            Empty where the drift is within the bound.
        """
        if drift <= self.bound:
            return ""
        return self.hinted(f"off by {drift:.2g}, at most {self.bound:.2g} is allowed")

    def hinted(self, message: str) -> str:
        """Append the hint to a message."""
        return f"{message}: {self.hint}" if self.hint else message


def refuse_warnings(act: Callable[[], Result], hint: str = "") -> Result:
    """Call a function and refuse its warnings, `HARMLESS` ones excepted.

    Parameters
    ----------
    hint : str
        How to mend it, appended to the warning.

    Returns
    -------
    object
        What the function returns.

    Raises
    ------
    BrokenPromiseError
        Quoting the first warning.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = act()
    told = [warning for warning in caught if not issubclass(warning.category, HARMLESS)]
    if told:
        raise BrokenPromiseError(f"warns {told[0].category.__name__}: {told[0].message}{hint}")
    return result
