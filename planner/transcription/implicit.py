"""Functions of unknowns that equations determine, with derivatives by the implicit function theorem.

The unknowns y come in blocks. The equations of block k, G_k(w, y) = 0, are linear in y_k with a regular matrix, and depend
otherwise on w and earlier blocks only. For functions F(w, y(w)) and f = lam^T F,

    Y = dy/dw = -G_y^-1 G_w,   dF/dw = F_w + F_y Y,
    d2f/dw2 = [I; Y]^T d2(f + mu^T G)/d(w, y)2 [I; Y],   mu = -G_y^-T f_y.

Derivatives of the solution's own expressions would repeat the elimination in every entry. With the 18 dependent joints of a
platform on six legs they take 950,000 operations instead of 117,000.
"""

import itertools
from collections.abc import Sequence

import casadi as ca

from linkplan.models.reduction.elimination import factorise

# The depth to which two expressions are compared, because a derivative may contain a copy of a sign or a product.
_COMPARED_LEVELS = 5


class Implicit:
    """Unknowns y (n,) that equations G(w, y) = 0 (n,) determine.

    Args:
        w: the given unknowns, symbols.
        y: the determined unknowns, symbols.
        equations: G, an expression.
        sizes: of the consecutive blocks of y and G.
    """

    def __init__(self, w: ca.SX, y: ca.SX, equations: ca.SX, sizes: Sequence[int]) -> None:
        sizes = [size for size in sizes if size]
        self._blocks = [slice(end - size, end) for end, size in zip(itertools.accumulate(sizes), sizes, strict=True)]
        self._w, self._y, self._equations = w, y, equations
        self._by_w, self._by_y = ca.jacobian(equations, w), ca.jacobian(equations, y)
        self._inverses = _inverses([self._by_y[block, block] for block in self._blocks])
        solution = ca.SX(0, 1)
        for block, inverse in zip(self._blocks, self._inverses, strict=True):
            known = ca.vertcat(solution, ca.SX.zeros(y.numel() - block.start))
            solution = ca.vertcat(solution, -inverse @ ca.substitute(equations[block], y, known))
        self._solution = ca.densify(solution)

    def inserted(self, expressions: list[ca.SX]) -> list[ca.SX]:
        """Return expressions of (w, y) with the solution in place of y."""
        return ca.substitute(expressions, [self._y], [self._solution]) if self._blocks else expressions

    def jacobian(self, F: ca.SX) -> ca.SX:
        """Return dF/dw (n_F, n_w) of an expression F of (w, y), before the solution is inserted."""
        direct = ca.jacobian(F, self._w)
        if not self._blocks:
            return direct
        adjoint = self._solved_transposed(ca.jacobian(F, self._y).T)
        return ca.sparsify(direct - ca.sparsify(adjoint.T) @ self._by_w)

    def hessian(self, f: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return d2f/dw2 (n_w, n_w) and df/dw (n_w,) of a scalar expression f, before the solution is inserted."""
        if not self._blocks:
            return ca.hessian(f, self._w)
        mu, n_w = ca.SX.sym("mu", self._y.numel()), self._w.numel()
        H, gradient = ca.hessian(f + ca.dot(mu, self._equations), ca.vertcat(self._w, self._y))
        Y = -ca.sparsify(self._solved(self._by_w))
        cross, own = H[:n_w, n_w:] @ Y, Y.T @ (H[n_w:, n_w:] @ Y)
        total = [ca.sparsify(H[:n_w, :n_w] + cross + cross.T + own), gradient[:n_w]]
        value = -self._solved_transposed(ca.gradient(f, self._y))
        hessian, gradient = ca.substitute(total, [mu], [ca.densify(value)])
        return hessian, gradient

    def _solved(self, b: ca.SX) -> ca.SX:
        """Return G_y^-1 b."""
        parts = ca.SX(0, b.shape[1])
        for block, inverse in zip(self._blocks, self._inverses, strict=True):
            left = b[block, :] - self._by_y[block, : block.start] @ parts
            parts = ca.vertcat(parts, inverse @ ca.sparsify(left))
        return parts

    def _solved_transposed(self, b: ca.SX) -> ca.SX:
        """Return G_y^-T b."""
        parts = ca.SX(0, b.shape[1])
        for block, inverse in zip(reversed(self._blocks), reversed(self._inverses), strict=True):
            left = b[block, :] - self._by_y[block.stop :, block].T @ parts
            parts = ca.vertcat(inverse.T @ ca.sparsify(left), parts)
        return parts


def _inverses(matrices: list[ca.SX]) -> list[ca.SX]:
    """Return the inverses of matrices; equal ones and transposed ones share their expressions."""
    found: list[ca.SX] = []
    for A in matrices:
        known = [X for B, X in zip(matrices, found, strict=False) if _are_equal(A, B)]
        known += [X.T for B, X in zip(matrices, found, strict=False) if _are_equal(A, B.T)]
        found.append(known[0] if known else ca.sparsify(factorise(A)(ca.SX.eye(A.shape[0]))))
    return found


def _are_equal(A: ca.SX, B: ca.SX) -> bool:
    return A.sparsity() == B.sparsity() and ca.is_equal(A, B, _COMPARED_LEVELS)
