"""Settings of the forward solver, and the budget of computation that a caller grants."""

from __future__ import annotations

from dataclasses import dataclass

UNLIMITED = 1_000_000
"""Newton steps or phases that no solve reaches."""


@dataclass(frozen=True)
class Convexification:
    """Schedule of the convexification weight: how much non-convex curvature Newton steps leave out.

    Far from a solution all of it is left out, near one none. Every full step that reduces the
    residual lowers the weight, every bad step raises it (Levenberg and Marquardt's rule; Nocedal
    and Wright, section 10.3). `benchmarks.stress` measures success rates and steps.
    """

    fall: float = 0.8
    """Factor of the weight after a good step."""
    rise: float = 20.0
    """Factor of the weight after a bad step."""
    full: float = 0.95
    """Part of a step, up to the first bound, above which it counts as full."""
    cut: float = 0.5
    """Part of a step below which it is bad."""
    thrown_back: float = 2.0
    """Factor of the residual above which a step is bad."""
    exact: float = 1e-3
    """Weight below which curvature is used exactly."""
    restart: float = 2e-3
    """Least weight that a bad step begins to raise: from exact curvature the weight is 0, and no
    factor would raise that. `benchmarks.sensitivity`."""
    sign_steps: int = 10
    """Newton-Schulz steps for the positive part of the curvature: eigenvalues above a twentieth of
    the matrix norm get their sign. `benchmarks.sensitivity`."""


@dataclass(frozen=True)
class Damping:
    """Schedule of step rejection and of the damping that follows it (module `newton.damping`).

    `benchmarks.stress` and `benchmarks.merge` measure success rates and steps.
    """

    raised: float = 20.0
    """Factor of the recent largest residual above which a step is undone."""
    least: float = 1.0
    """Recent largest residual that is assumed at least: phases from a similar game's solution begin
    with small residuals, and may raise them."""
    memory: float = 0.5
    """Factor, per step, of the recent largest residual."""
    begin: float = 1.0
    """Damping after the first rejection, in units of the stage cost's second derivatives."""
    rise: float = 10.0
    """Factor of the damping after another rejection."""
    fall: float = 0.1
    """Factor of the damping after a step that reduces the residual."""
    end: float = 0.5
    """Part of `begin` below which the damping is set to 0. `benchmarks.sensitivity`."""
    most: float = 1e6
    """Damping at which a phase ends."""


@dataclass(frozen=True)
class Softness:
    """Proximal terms of multipliers in linear systems; `benchmarks.sensitivity` varies them.

    Units: constraint value per multiplier. They vanish at the solution of a Newton iteration.
    """

    equality: float = 1e-8
    """Of equality rows: keeps stage matrices regular without a constraint qualification."""
    least: float = 1e-10
    """Of inequality rows: no active row weighs more than its inverse in the stage matrices, where
    rounding would swallow the players' own curvature."""
    final: float = 1e-8
    """The same where the residual is below `final_residual`, and multipliers hardly move any more.
    From the beginning, phases of games without a solution would take all their steps."""
    final_residual: float = 1e-3
    """Largest entry of the scaled KKT residual below which `final` holds."""
    tangent: float = 1e-5
    """Of all rows in the linear system of derivatives, where active rows would otherwise weigh up
    to the inverse of the barrier."""
    tangent_corrections: int = 2
    """Further solves that take the influence of `tangent` back (proximal point iteration)."""


@dataclass(frozen=True)
class CentralPath:
    """How interior-point steps begin, follow and end; `benchmarks.sensitivity` varies the values.

    Mehrotra's predictor and corrector (Nocedal and Wright, algorithm 14.3) has the same settings.
    """

    width: float = 1e-2
    """Least complementarity product of a step, as a ratio to the residual: on a path too narrow to
    follow the curvature of others' constraints, steps are cut to nothing."""
    fraction: float = 0.99
    """Least part of the way to the first bound that a step takes."""
    corrector_end: float = 10.0
    """Average product, in final ones, below which steps have no corrector: at the end of the path
    plain Newton steps converge quadratically."""
    end_width: float = 0.01
    """Largest deviation of products from the final one, relative to it, at a solution: so narrow a
    path makes the solution a function of the parameters alone, whatever the start."""
    smoothed_tolerance: float = 1e-3
    """Tolerance of a smoothed game's residual as a ratio to its complementarity product."""
    least_slack: float = 0.1
    """Least slack at the start of a phase, in the constraint's own unit."""
    most_share: float = 0.5
    """Most part of an elastic row's penalty that its multiplier starts with."""
    warm_margin: float = 1e-3
    """Part of the penalty that multipliers of elastic rows keep from 0 and from the penalty where a
    similar game's solution is moved off the boundary."""


@dataclass(frozen=True)
class SolverOptions:
    """Settings of the forward solver; `benchmarks.stress` and `benchmarks.forward` derive them.

    A solve runs phases until one succeeds: from a similar game's solution a *semismooth Newton
    phase* and `warm_phases` *interior-point phases*, then the interior-point phases of
    `barrier_schedule`. `Budget` limits how many.
    """

    tolerance: float = 1e-8
    """Largest entry of the scaled KKT residual at which a game counts as solved."""
    barrier: float = 1e-9
    """Complementarity product at the solution: the solution is a smooth function of parameters."""
    barrier_schedule: tuple[float, ...] = (0.1, 0.1, 1.0, 100.0, 10.0)
    """Complementarity product at the start of each interior-point phase. The first phase begins at
    the start itself, later ones at perturbed controls and with exact curvature used earlier. A
    small product stays near the equilibrium that it begins at; costs in the hundreds need a large
    one."""
    linear_steps: int = 80
    """Newton steps per interior-point phase where all dynamics are linear."""
    nonlinear_steps: int = 200
    """Newton steps per interior-point phase where some dynamics are nonlinear."""
    exact_below: float = 1e-2
    """Residual below which all curvature is used exactly."""
    semismooth_steps: int = 10
    """Steps of the semismooth Newton phase from a similar game's solution."""
    semismooth_trial: int = 3
    """Semismooth steps after which the residual must not be above that of their start: steps that
    have raised it seldom converge. `benchmarks.sensitivity`."""
    warm_phases: int = 2
    """Interior-point phases from a similar game's solution, the second from its perturbed controls,
    before it is discarded: more of them repeat a start that fails, fewer lose the equilibrium that
    other agents expect. `benchmarks.egos`."""
    warm_steps: int = 45
    """Newton steps of the first of these: few that converge take more.
    `benchmarks.sensitivity`."""
    warm_barrier: float = 1e-2
    """Complementarity product that a solution is moved to before these phases: smaller ones stay at
    its active set, larger ones forget it. `benchmarks.sensitivity`."""
    warm_exactness: float = 10.0
    """Factor of `exact_below` in the first of these phases: curvature there is that of a solution.
    `benchmarks.sensitivity`."""
    runaway_multiplier: float = 1e8
    """Multiplier of a violated constraint at which a phase ends, before numbers overflow."""
    violated: float = 1e-4
    """Violation, in the constraint's own unit, above which a constraint is unmet.
    `benchmarks.sensitivity`."""
    infeasible_multiplier: float = 1e3
    """Multiplier above which a failed game with an unmet constraint counts as infeasible, not as
    unfinished. `benchmarks.stress` counts how many of these are proven to have no solution."""
    perturbation: float = 0.5
    """Amplitude of the perturbation of controls, in their own unit, at the second phase; it grows
    by as much with every further phase. `benchmarks.sensitivity`."""
    exact_growth: float = 10.0
    """Factor of `exact_below` from one phase of `barrier_schedule` to the next.
    `benchmarks.sensitivity`."""
    convexification: Convexification = Convexification()
    damping: Damping = Damping()
    softness: Softness = Softness()
    path: CentralPath = CentralPath()

    def __post_init__(self) -> None:
        object.__setattr__(self, "barrier_schedule", tuple(self.barrier_schedule))
        if not self.barrier_schedule or not all(b > 0.0 for b in self.barrier_schedule):
            raise ValueError(
                f"barrier_schedule: is {self.barrier_schedule}; expected positive numbers, at "
                "least one"
            )
        for name in (
            "tolerance",
            "barrier",
            "warm_barrier",
            "exact_below",
            "exact_growth",
            "perturbation",
            "violated",
            "runaway_multiplier",
            "infeasible_multiplier",
        ):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name}: is {getattr(self, name)}; expected more than 0")
        for name in (
            "linear_steps",
            "nonlinear_steps",
            "semismooth_steps",
            "semismooth_trial",
            "warm_phases",
            "warm_steps",
        ):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: is {getattr(self, name)}; expected at least 1")


@dataclass(frozen=True)
class VerificationSettings:
    """Settings of `verify`; `benchmarks.sensitivity` counts confirmed equilibria with them."""

    stiffness: float = 1e4
    """Curvature across active constraints, relative to the largest of the player's Lagrangian: the
    subspace that they leave free decides the smallest eigenvalue."""
    perturbation: float = 1e-3
    """Amplitude of the perturbation of controls, in their own unit, that best responses start
    from: a saddle is left."""
    rounding: float = 1e-6
    """Improvement relative to the cost, at least 1, up to which a gap counts as rounding."""


@dataclass(frozen=True)
class Budget:
    """Limit of the computation of a solve, a fit or an estimator's update.

    One setting for `solve`, `estimate`, `MovingHorizonEstimator` and the egos. Presets:
    `Budget.offline()`, `Budget.online()`, `Budget.realtime()` and `Budget.trial()`.

    Raises:
        ValueError: a limit is below 1 (Gauss-Newton steps: below 0); the message names it.
    """

    phases: int | None = None
    """Most interior-point phases of a solve, after the semismooth one from a solution; None: the
    whole schedule."""
    newton_steps: int | None = None
    """Most Newton steps of an interior-point phase; None: as `SolverOptions` has them."""
    trial_newton_steps: int = 25
    """Newton steps of the single phase that a trial step of a fit gets: a step to parameters whose
    game is not solved soon is refused. `benchmarks.inverse`."""
    gauss_newton_steps: int | None = None
    """Most Gauss-Newton steps of a fit that continues from the last one; None: as many as the
    method has. With 0 an update solves one game, where a step on the last fit's derivatives
    leads."""
    fits: int = 3
    """Most fits of an estimator's update: from the last one, from the observations, and from the
    last one again where the fit from the observations is not better."""

    def __post_init__(self) -> None:
        least = {"phases": 1, "newton_steps": 1, "trial_newton_steps": 1, "fits": 1}
        for name, low in (*least.items(), ("gauss_newton_steps", 0)):
            value = getattr(self, name)
            if value is not None and value < low:
                raise ValueError(f"budget.{name}: is {value}; expected at least {low}")

    @classmethod
    def offline(cls) -> Budget:
        """Return no further limits than the solver's and the method's.

        Returns:
            The default of `solve` and `estimate`.
        """
        return cls()

    @classmethod
    def online(cls) -> Budget:
        """Return the limits of a moving-horizon estimator: three Gauss-Newton steps per fit.

        Fits need not converge, since the next update continues them (Diehl, Bock and Schloder, "A
        real-time iteration scheme for nonlinear optimization in optimal feedback control", SIAM J.
        Control Optim. 43, 2005).

        Returns:
            The default of `MovingHorizonEstimator`.
        """
        return cls(gauss_newton_steps=3)

    @classmethod
    def realtime(cls) -> Budget:
        """Return the limits of one game of one phase per update.

        With fewer than 40 Newton steps more updates among cars fail (`benchmarks.driving`).

        Returns:
            Limits for estimators and egos with little time.
        """
        return cls(phases=1, newton_steps=40, trial_newton_steps=40, gauss_newton_steps=0, fits=1)

    @classmethod
    def trial(cls) -> Budget:
        """Return the limits of one short phase, for solves whose result is useless when late.

        `benchmarks.sensitivity` has the share of games that 25 Newton steps solve.

        Returns:
            Limits of one solve.
        """
        return cls(phases=1, newton_steps=25)

    @property
    def single_game(self) -> bool:
        """Whether an estimator's update solves a single game."""
        return self.gauss_newton_steps == 0
