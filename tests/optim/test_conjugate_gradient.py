"""Conjugate gradient against LAPACK's direct solver."""

import pytest
import torch

from pemirl_trl.optim import conjugate_gradient

pytestmark = pytest.mark.usefixtures("float64")


def positive_definite(size):
    root = torch.randn(size, size)
    return root @ root.T + torch.eye(size)


def test_it_solves_the_system():
    matrix, rhs = positive_definite(12), torch.randn(12)
    solution, residual = conjugate_gradient(lambda v: matrix @ v, rhs, 40, tolerance=1e-24)
    assert torch.allclose(solution, torch.linalg.solve(matrix, rhs), rtol=1e-8)
    assert residual < 1e-12


@pytest.mark.parametrize("iterations", [1, 3, 6])
def test_the_residual_is_that_of_the_answer(iterations):
    matrix, rhs = positive_definite(12), torch.randn(12)
    solution, residual = conjugate_gradient(lambda v: matrix @ v, rhs, iterations)
    actual = (rhs - matrix @ solution).norm() / rhs.norm()
    assert residual > 1e-4
    assert residual == pytest.approx(actual.item(), rel=1e-8)


def test_one_product_for_each_distinct_eigenvalue():
    products = 0
    diagonal = torch.tensor([1.0, 5.0]).repeat(4)

    def product(vector):
        nonlocal products
        products += 1
        return diagonal * vector

    solution, _ = conjugate_gradient(product, torch.ones(8), iterations=8)
    assert torch.allclose(solution, 1 / diagonal)
    assert products == 2


@pytest.mark.parametrize("factor", [1e-12, 1e12])
def test_scaling_the_right_hand_side_scales_the_solution(factor):
    matrix, rhs = positive_definite(6), torch.randn(6)
    solution, residual = conjugate_gradient(lambda v: matrix @ v, rhs, 4)
    scaled, same = conjugate_gradient(lambda v: matrix @ v, factor * rhs, 4)
    assert torch.allclose(scaled / factor, solution)
    assert same == pytest.approx(residual, rel=1e-6)


def test_zero_has_the_solution_zero():
    solution, residual = conjugate_gradient(lambda v: 2 * v, torch.zeros(3))
    assert torch.equal(solution, torch.zeros(3))
    assert residual == 0.0
