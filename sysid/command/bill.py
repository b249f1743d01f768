"""The bill of a run: the seconds of each stage, the numerical error that it leaves, and what more accuracy
would take."""

import math
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from sysid.report.text import span

if TYPE_CHECKING:
    from sysid.command.clock import Budget
    from sysid.posterior.posterior import Offer, Posterior


def ladder(posterior: "Posterior") -> "list[Posterior]":
    """The rungs that were climbed, the first one first."""
    return [*(ladder(posterior.below) if posterior.below else ()), posterior]


def bill(posterior: "Posterior", budget: "Budget") -> dict[str, Any]:
    """`cost` of fit.json: what the stages took so far, and what the next rung would take.

    Errors are in standard deviations of the parameter that has the largest: after the fit those of its normal
    approximation.
    """
    first, last = ladder(posterior)[0], posterior
    left = {"read": 0.0, "fit": first.error, "sample": last.error}
    rows = [
        {"stage": name, "seconds": spent, "error": left.get(name)}
        for name, spent in budget.stages.seconds.items()
    ]
    offer, twice = posterior.offer(), posterior.twice()
    if offer and posterior.below is None:
        offer = replace(offer, seconds=offer.seconds + budget.starting)
    cost = {
        "total_s": round(budget.spent, 3),
        "budget_s": budget.seconds,
        "stages": rows,
        "twice_as_exact_s": twice,
    }
    return cost | {"next": offer and asdict(offer), "sentence": sentence(last.error, twice, offer)}


def sentence(error: float, twice: float | None, offer: "Offer | None") -> str:
    """How exact the numbers are, and what it would take to have them more exact."""
    if not math.isfinite(error):
        return "how exact the numbers are is not known, as the logs do not bound them"
    parts = [f"means and intervals are exact to {error:.1g} standard deviations"]
    if twice is not None:
        parts.append(f"twice as exact would take {span(twice)} more")
    if offer is not None:
        parts.append(f"--accuracy {offer.accuracy} would take {span(offer.seconds)} more, for {offer.brings}")
    return "; ".join(parts)
