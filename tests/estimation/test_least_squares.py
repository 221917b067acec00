"""The minimiser and what every problem of it shares, against differences and a known minimum."""

import numpy as np
import pytest

from dgc_pose.estimation.least_squares import Slopes, cauchy_losses, cauchy_slopes, minimised

WIDTH = 0.7


class _Valley:
    """The errors 1 - x and 10 (y - x^2) of Rosenbrock (1960), least at (1, 1). evaluated: fits."""

    def __init__(self) -> None:
        self.evaluated = list[np.ndarray]()

    def linearised(self, fit: np.ndarray) -> Slopes:
        self.evaluated.append(fit)
        x, y = fit
        errors = np.array([1 - x, 10 * (y - x**2)])
        slopes = np.array([[-1.0, 0], [-20 * x, 10]])
        return Slopes(float(errors @ errors) / 2, slopes.T @ slopes, slopes.T @ errors)

    def moved(self, fit: np.ndarray, step: np.ndarray) -> np.ndarray:
        return fit + step


def test_each_step_lowers_the_cost_until_none_promises_a_gain() -> None:
    valley = _Valley()
    found = minimised(valley, np.array([-1.2, 1.0]), 100, converged=1e-12)
    np.testing.assert_allclose(found, [1, 1], atol=1e-4)
    assert len(valley.evaluated) < 60
    costs = [_Valley().linearised(fit).cost for fit in valley.evaluated]
    assert max(costs) > costs[0]  # a step that was refused
    assert _Valley().linearised(found).cost < 1e-8
    # Where the costs of two fits do not compare, each step is taken: two of Gauss and Newton.
    free = minimised(_Valley(), np.array([-1.2, 1.0]), 5, descends=False, converged=1e-12)
    np.testing.assert_allclose(free, [1, 1], atol=1e-4)


def test_a_parameter_that_nothing_depends_on_leaves_the_start() -> None:
    class Flat(_Valley):
        def linearised(self, fit: np.ndarray) -> Slopes:
            return Slopes(1.0, np.diag([1.0, 0]), np.array([1.0, 0]))

    start = np.array([3.0, 4.0])
    assert minimised(Flat(), start, 10) is start
    # Steps that are not damped are the shortest ones, along the other parameters alone.
    np.testing.assert_allclose(minimised(Flat(), start, 1, descends=False), [2, 4])


def test_a_last_step_that_raises_the_cost_is_not_taken() -> None:
    """As one beyond what a lens can have seen, however small the gain that it promises."""

    class Cliff(_Valley):
        def linearised(self, fit: np.ndarray) -> Slopes:
            cost = np.inf if fit[0] > 1 else 1.0
            return Slopes(cost, np.eye(2), np.array([-1e-3, 0]))

    start = np.array([1.0, 0.0])
    assert minimised(Cliff(), start, 10) is start


@pytest.mark.parametrize("axes", [(), (3,)])
def test_the_slopes_of_losses_and_prior_are_those_of_their_sum(axes: tuple[int, ...]) -> None:
    """Of single errors, and of errors whose length counts."""
    rng = np.random.default_rng(0)
    errors = rng.standard_normal((40, *axes))
    slopes = rng.standard_normal((40, *axes, 5))
    counts = rng.random(40)
    values = rng.standard_normal(2)
    information = np.array([1.0, 4.0])

    def cost(step: np.ndarray) -> float:
        moved = errors + slopes @ step
        lengths = np.linalg.norm(moved, axis=1) if axes else moved
        prior = (values + step[3:]) ** 2 @ information / 2
        return float(counts @ cauchy_losses(lengths, WIDTH) + prior)

    found = cauchy_slopes(errors, slopes, WIDTH, counts).with_prior(values, information)
    assert found.cost == pytest.approx(cost(np.zeros(5)))
    numeric = [(cost(step) - cost(-step)) / 2e-5 for step in 1e-5 * np.eye(5)]
    np.testing.assert_allclose(found.gradient, numeric, rtol=1e-5, atol=1e-7)
    # Without outliers the Hessian is that of squares.
    exact = cauchy_slopes(0 * errors, slopes, WIDTH).with_prior(values, information)
    step = 1e-4 * rng.standard_normal(5)
    errors = 0 * errors
    counts = np.ones(40)
    curvature = cost(step) + cost(-step) - 2 * cost(np.zeros(5))
    assert step @ exact.hessian @ step == pytest.approx(curvature, rel=1e-4)


def test_an_infinite_cost_gives_no_step() -> None:
    """As of a point that a lens cannot have seen."""
    found = cauchy_slopes(np.array([1.0, np.inf]), np.ones((2, 3)), WIDTH)
    assert found.cost == np.inf and not found.gradient.any() and not found.step(0.0).any()
