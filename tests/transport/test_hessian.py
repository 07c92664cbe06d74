"""Hessian-vector products against finite differences of gradients."""

import pytest
import random_problems

import clmorph
from clmorph.errors import InputError


def test_products_are_differences_of_gradients():
    """Of values and of divergences, balanced or not."""
    found = random_problems.worst("second", 16, "numpy")
    assert all(share <= 1 for share, _ in found.values()), found


def test_mistakes_are_named(rng):
    parts = [rng.random((6, 2)), rng.random(6) + 0.5, rng.random((8, 2)), rng.random(8) + 0.5]
    change = [rng.standard_normal(each.shape) for each in parts]
    pair = (parts[1], parts[0]), (parts[3], parts[2])
    solved = clmorph.sinkhorn(*pair, blur=0.3, reach=0.5, backend="numpy")
    good = clmorph.Gradient(*change)
    for arguments, words in (
        ((*pair, None, good), "solved"),
        ((*pair, solved, None), "direction"),
        ((*pair, solved, clmorph.Gradient(*change[::-1])), "direction: source_points"),
        (((0 * parts[1] + [0, 1, 1, 1, 1, 1], parts[0]), pair[1], solved, good), "positive"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            clmorph.hessian_product(*arguments)
        assert "\n" not in str(caught.value)
