"""Sparse convex quadratic programme, solved by a primal-dual interior-point method.

Mehrotra's predictor-corrector in the inequality form of Nocedal and Wright, Numerical
Optimization, 2nd ed., section 16.6. scipy has bounded least squares but no solver for a quadratic
programme with general linear inequalities, and the line needs those for its curvature limit.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from planner.road import FloatArray

_ITERATIONS_MAX = 40
_STEP_SHARE = 0.995  # stay strictly inside the positive orthant


def solve_quadratic_programme(
    hessian: sparse.csc_matrix,
    gradient: FloatArray,
    constraints: sparse.csc_matrix,
    bounds: FloatArray,
    tolerance: float = 1e-6,
) -> FloatArray:
    """Return the x that minimises `x'Hx/2 + g'x` subject to `Gx <= h`.

    Args:
        hessian: H, symmetric positive definite, shape (n, n).
        gradient: g, shape (n,).
        constraints: G, shape (m, n).
        bounds: h, shape (m,); there must be an x with Gx < h.
        tolerance: On the mean complementarity and on the residuals, in the problem's own scale.

    The result is the last iterate when 40 iterations do not reach the tolerance; callers check
    what they need of it.
    """
    count = len(bounds)
    transposed = constraints.T.tocsc()
    x = np.zeros(len(gradient))
    slack = np.maximum(bounds - constraints @ x, 1.0)
    dual = np.ones(count)
    for _ in range(_ITERATIONS_MAX):
        residual_dual = hessian @ x + gradient + transposed @ dual
        residual_primal = constraints @ x + slack - bounds
        gap = float(slack @ dual) / count
        worst = max(float(np.abs(residual_dual).max()), float(np.abs(residual_primal).max()))
        if gap < tolerance and worst < tolerance:
            break
        newton = _NewtonSystem(
            factor=splu(
                (hessian + transposed @ sparse.diags(dual / slack) @ constraints).tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                options={"SymmetricMode": True},
            ),
            constraints=constraints,
            transposed=transposed,
            slack=slack,
            dual=dual,
            residual_dual=residual_dual,
            residual_primal=residual_primal,
        )
        _, dslack, ddual = newton.step(slack * dual)
        step = min(_step_to_edge(slack, dslack), _step_to_edge(dual, ddual))
        gap_affine = float((slack + step * dslack) @ (dual + step * ddual)) / count
        centring = (gap_affine / gap) ** 3
        dx, dslack, ddual = newton.step(slack * dual + dslack * ddual - centring * gap)
        step = _STEP_SHARE * min(_step_to_edge(slack, dslack), _step_to_edge(dual, ddual))
        x = x + step * dx
        slack = slack + step * dslack
        dual = dual + step * ddual
    return x


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _NewtonSystem:
    """The linearised optimality conditions of one iteration, factorised once, solved twice."""

    factor: SuperLU
    constraints: sparse.csc_matrix
    transposed: sparse.csc_matrix
    slack: FloatArray
    dual: FloatArray
    residual_dual: FloatArray
    residual_primal: FloatArray

    def step(self, complementarity: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the changes of x, slack and dual for the complementarity to be removed."""
        inner = (self.dual * self.residual_primal - complementarity) / self.slack
        dx: FloatArray = self.factor.solve(-self.residual_dual - self.transposed @ inner)
        dslack: FloatArray = -self.residual_primal - self.constraints @ dx
        ddual: FloatArray = -(complementarity + self.dual * dslack) / self.slack
        return dx, dslack, ddual


def _step_to_edge(values: FloatArray, changes: FloatArray) -> float:
    """Return the largest step in (0, 1] that keeps all values non-negative."""
    falling = changes < 0.0
    if not falling.any():
        return 1.0
    return min(1.0, float(np.min(-values[falling] / changes[falling])))
