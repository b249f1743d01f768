"""How a fit ended, and what is known of one parameter."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

NORMAL95 = 1.959964  # standard deviations within which 95 % of normal numbers lie


class Result(StrEnum):
    """How it ended; a member is its message.

    >>> Result.successful == "successful", Result.misfit.bounded
    (True, True)
    """

    successful = "successful"
    not_converged = "the fit did not converge"
    misfit = "the model does not describe the logs"
    undetermined = "the logs do not determine tau or G"
    sampler_stopped = "the sampler stopped before it reached its criteria"

    @property
    def usable(self) -> bool:
        """Whether the values are the plate's: of any other fit even a determined one is not to be used."""
        return self is Result.successful

    @property
    def bounded(self) -> bool:
        """Whether the logs bound the parameters, so that there is a posterior to draw from."""
        return self in (Result.successful, Result.misfit, Result.sampler_stopped)


@dataclass(frozen=True)
class Parameter:
    """One parameter with its error; `value`, `std` and `ci95` are None and `why` a sentence when not
    determined."""

    value: float | None
    std: float | None
    ci95: tuple[float, float] | None
    unit: str
    determined: bool
    why: str | None = None
    modes: tuple[dict, ...] = ()

    def __getitem__(self, name: str) -> Any:
        """`parameter["ci95"]`: the fields by name, as they stand in fit.json."""
        if name not in self.__dataclass_fields__:
            raise KeyError(name)
        return getattr(self, name)
