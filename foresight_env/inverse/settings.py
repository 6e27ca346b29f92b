"""Settings of the estimator that callers seldom change; `benchmarks.sensitivity` varies each."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the search by damped Gauss-Newton steps, and of the choice among its starts."""

    stalls: int = 2
    """Steps in a row without a change of the cost after which a search ends."""
    smooth_tolerance: float = 3e-2
    """Relative change of the cost that counts as none while the game is smoothed."""
    damping: float = 0.3
    """Damping of the first step. With less, first steps go so far that the games there take many
    Newton steps, only to be refused."""
    phase_damping: float = 1e-2
    """Least damping of the first step after a change of `GaussNewton.smoothing`: the game is less
    smooth than the one before."""
    pull: float = 1e-2
    """Weight, relative to the data's information at the start, of a pull of the parameters towards
    their first values while the game is smoothed. A smoothed game never quite reaches a bound that
    the observed agents rest on; without the pull parameters run off."""
    too_far: float = 30.0
    """Cost of a step, in multiples of the cost before it, above which damping rises much more."""
    falls: float = 0.2
    """Factor of the damping after a step that lowered the cost."""
    rises: float = 6.0
    """Factor of the damping after one that did not."""
    rises_much: float = 36.0
    """Factor of the damping after one that went too far: games far away take many Newton steps, so
    a second one nearly as far is not tried."""
    least_damping: float = 1e-9
    """Damping below which it no longer falls: Gauss-Newton without damping, to rounding."""
    tracking_solves: int = 3
    """Forward solves per weight of the tracking term that do not count as iterations."""
    same_cost: float = 0.01
    """Difference of a chi-squared sum, in which one deviation is 1, up to which two starts count as
    having reached the same fit."""
    plausible: float = 3.0
    """Deviations of a chi-squared sum above its expectation up to which a fit that two starts have
    reached ends the search."""


@dataclass(frozen=True)
class TrackingSettings:
    """Settings of the trajectory that follows the observations (module `tracking`)."""

    effort: float = 0.1
    """Price of a squared control unit relative to a squared deviation of tracking error."""
    scale: float = 10.0
    """Weight of the least certain observation: small noise must not demand jerks."""
    inverse_steps: int = 5
    """Gauss-Newton steps per stage from states to the controls between them."""
    kept: float = 1e-3
    """Weight of the previous controls, and of entries that are not observed, relative to observed
    entries."""
    accuracy: float = 1e-4
    """Tolerance and complementarity product of the tracking game, which is a start only."""


@dataclass(frozen=True)
class EstimatorSettings:
    """Settings of `estimate` beyond its method's."""

    search: SearchSettings = SearchSettings()
    tracking: TrackingSettings = TrackingSettings()


@dataclass(frozen=True)
class WalkSettings:
    """Settings of the walks of a profile likelihood along a discount factor."""

    narrowest: float = 5e-3
    """Least step, in units of the discount factor."""
    widest: float = 0.25
    """Largest step, in units of the discount factor."""
    growth: float = 3.0
    """Largest ratio of a point's distance from the estimate to that of the point before."""
    close: float = 0.15
    """Relative error of `sqrt(rise)` at which a point counts as the interval's end."""
    better: float = 0.1
    """By how much a fit on the way has to be better to become the estimate: a chi-squared sum, in
    which one deviation is 1."""
    tolerance: float = 1e-3
    """Relative change of the objective that counts as none on the way."""
    from_smoothed: int = 3
    """Factor of `Profile.iterations` for a fit that begins with a smoothed game."""
    renewals: int = 3
    """Better minima after which no more are followed."""


@dataclass(frozen=True)
class ProposalSettings:
    """Settings of the proposals of importance sampling (module `importance`)."""

    freedom: float = 5.0
    """Degrees of freedom of the Student distribution: tails that a density is unlikely to
    exceed."""
    least_deviation: float = 1e-4
    """Of a proposal, in ranks of discount factors."""
    most_deviation: float = 0.5
    """The same; so wide a proposal covers the unit cube."""
    correlation: float = 0.95
    """Factor of estimated correlations, which few samples exaggerate."""
    flattest: float = 1e-3
    """Least variance along an axis of the proposal, relative to the largest."""
    wider: float = 1.3
    """Factor of the weighted samples' deviations: a proposal that is too wide costs less than one
    that is too narrow."""
    candidates: int = 4096
    """Draws by which the part of a proposal inside the cube is counted."""


@dataclass(frozen=True)
class GibbsSettings:
    """Settings of the Gibbs sampler of truncated Gaussians (Kotecha and Djuric, ICASSP 1999)."""

    sweeps: int = 160
    """Passes over all bounded entries."""
    burn_in: int = 20
    """First sweeps that do not count."""
    chains: int = 8
    """Per distribution."""


@dataclass(frozen=True)
class SampleSettings:
    """Settings of the fits of a posterior's samples, and of their averages."""

    first_deviation: float = 2.0
    """Deviation of the first proposal in Laplace deviations, which kinks of the objective make too
    small."""
    close: float = 0.1
    """Distance in ranks of discount factors up to which a sample is fitted from a neighbour; one
    farther off is fitted from the observations, at the equilibrium that they show."""
    tolerance: float = 1e-3
    """Relative change of the objective that counts as none in fits of samples."""
    ridge: float = 1e-6
    """Information that parameters have without data, relative to that of the data."""
    negligible: float = 1e-6
    """Weight below which a sample is left out of averages."""
    proposal: ProposalSettings = ProposalSettings()
    gibbs: GibbsSettings = GibbsSettings()


@dataclass(frozen=True)
class UpdateSettings:
    """Settings of the moving-horizon estimator's updates: when another equilibrium is looked for.

    `benchmarks.online` measures updates with them.
    """

    plausible: float = 1.5
    """Reduced chi-squared up to which none is: of 30 degrees of freedom, noise alone leaves more
    once in twenty times."""
    worse: float = 1.3
    """Rise of a larger one, as a ratio to the update before, after which one is; without a rise it
    is looked for once per window."""
    abandoned: float = 4.0
    """Reduced chi-squared of the first game of a fit from the last solution, as a ratio to the
    update before (or to `plausible`, if that is larger), above which the fit ends: the shifted
    solution has led to another equilibrium."""
    initial_updates: int = 4
    """Updates at the beginning that fit from the observations, with little data, where fits take
    more than one game."""
    least_smoothing: float = 1e-9
    """Least complementarity product of an update's games: that of a solve."""
    most_smoothing: float = 1e-3
    """Largest complementarity product of an update's games, whatever the noise's variance."""
