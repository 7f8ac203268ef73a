"""By which law does an energy error grow? Four candidates, and how much better the best one is.

The error is followed by its envelope A(t), the largest size so far: an oscillation that stays within
its bounds has a constant envelope, whatever its phase. In its logarithm every law is a straight
line or nearly so:

    bounded       A = c
    random walk   A = c t^(1/2)
    linear        A = c t
    exponential   A = c (exp(rate t) - 1)

Each is fitted by least squares of log A over the last three decades of time, and they are compared by
the Bayesian information criterion, n log(RSS/n) + k log n, k the free numbers of the law. Residuals of
an envelope are not independent, so the criterion ranks the laws and is no probability; beside it
stands the exponent d log A/d log t with its standard error, which assumes no law.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy import optimize, stats

WINDOW = 1e-3
"""The fit begins at this part of the time that was covered."""

LEAST_POINTS = 8
DECISIVE = 10.0
"""A difference of the criterion from which one law is preferred to another (Kass and Raftery, 1995)."""

NEAR = 0.15
"""How far the exponent may be from that of the law of powers that bears its name."""

FLAT = 0.02
"""The largest exponent of a bounded error whose standard error is nothing: it rises by 15 % in all."""

_POWERS = {"bounded": 0.0, "random walk": 0.5, "linear": 1.0}


class DriftLaw(NamedTuple):
    """The law of an envelope.

    Attributes:
        law: bounded, random walk, linear or exponential; "power" where no candidate is near the
            exponent; "undecided" where two are equally good; "none" where there is no error to follow.
        rate: of the law, per s: c of the linear, the rate of the exponential; NaN of the others.
        exponent, standard_error: of log A against log t.
        evidence: by how much the criterion prefers the law to the runner-up.
        runner_up: the next best law.
    """

    law: str
    rate: float
    exponent: float
    standard_error: float
    evidence: float
    runner_up: str


NO_LAW = DriftLaw("none", math.nan, math.nan, math.nan, math.nan, "")


def fit_drift_law(times: np.ndarray, errors: np.ndarray) -> DriftLaw:
    """Fit the laws to an energy error.

    Args:
        times: s, increasing, shape (K,).
        errors: the largest size of the error in the interval that ends at each time, shape (K,).
    """
    with np.errstate(invalid="ignore"):
        good = np.isfinite(errors) & (np.maximum.accumulate(errors) > 0.0) & (times > 0.0)
    times, envelope = times[good], np.maximum.accumulate(errors[good])
    if times.size:
        late = times >= WINDOW * times[-1]
        times, envelope = times[late], envelope[late]
    if times.size < LEAST_POINTS:
        return NO_LAW
    t, a = np.log(times), np.log(envelope)
    slope = stats.linregress(t, a)
    rates = {law: math.exp(np.mean(a - power * t)) for law, power in _POWERS.items()}
    criteria = {
        law: _criterion(a - math.log(rates[law]) - power * t, 1) for law, power in _POWERS.items()
    }
    rates["exponential"], residuals = _exponential(times, a)
    criteria["exponential"] = _criterion(residuals, 2)
    if criteria["linear"] - criteria["exponential"] < DECISIVE:
        del criteria["exponential"]  # slow growth begins as a line: the simpler law is named
    best, second = sorted(criteria, key=lambda law: criteria[law])[:2]
    evidence = criteria[second] - criteria[best]
    law = best if evidence >= DECISIVE else "undecided"
    # A slow climb is no bound, however little of a random walk it is: a bounded error has an
    # exponent that cannot be told from nothing.
    near = min(NEAR, max(FLAT, 3.0 * slope.stderr)) if law == "bounded" else NEAR
    if law in _POWERS and abs(slope.slope - _POWERS[law]) > near:
        law = "power"
    rate = rates[best] if law in ("linear", "exponential") else math.nan
    return DriftLaw(law, rate, slope.slope, slope.stderr, evidence, second)


def _exponential(times: np.ndarray, a: np.ndarray) -> tuple[float, np.ndarray]:
    """The rate of A = c (exp(rate t) - 1) and the residuals of log A."""

    def model(t: np.ndarray, log_c: float, log_rate: float) -> np.ndarray:
        grown = np.exp(log_rate) * t
        # log(exp(x) - 1), also where exp(x) overflows
        return log_c + grown + np.log(-np.expm1(-grown))

    found = None
    for begin in (0.1, 10.0, 1000.0):  # e-foldings in all: a start near the answer
        guess = math.log(begin / times[-1])
        level = float(np.mean(a - model(times, 0.0, guess)))
        fit = optimize.least_squares(lambda p: a - model(times, *p), (level, guess), x_scale="jac")
        if np.isfinite(fit.fun).all() and (
            found is None or fit.cost < np.square(found[1]).sum() / 2
        ):
            found = math.exp(fit.x[1]), fit.fun
    return found or (math.nan, np.full(times.size, math.inf))


def _criterion(residuals: np.ndarray, free: int) -> float:
    n = residuals.size
    # A law that fits to six digits fits: without the floor rounding would be the judge.
    return n * math.log(float(np.square(residuals).mean()) + 1e-12) + free * math.log(n)
