"""Compare metrics of color, constant or for each source pixel, with the dense cost."""

import numpy as np
import plain
import pytest
from plain import lift, reference, sinkhorn

from clmorph import InputError, transport_plan
from clmorph.measures.points import as_pair


@pytest.fixture
def metrics(rng):
    """A random metric for every pixel of a 9 x 7 image."""
    factors = rng.normal(size=(9, 7, 3, 3))
    return np.einsum("hwij,hwkj->hwik", factors, factors) / 3


def test_the_bilinear_lifting_is_the_cost(rng, metrics):
    source = lift(rng.random((9, 7, 3)), 1.3, color_metric=metrics)
    target = lift(rng.random((6, 8, 3)), 1.3)
    x, y = as_pair(source, target)
    cost = 0.5 * np.sum((x.points[:, None] - y.points) ** 2, axis=2)
    cost += x.offsets[:, None] + y.offsets
    assert np.abs(cost - reference.cost_matrix(source, target)).max() < 1e-12


@pytest.mark.parametrize("kind", ["constant", "map", "weights"])
def test_plan_agrees_with_the_reference(device, rng, metrics, kind):
    images = rng.random((9, 7, 3)), rng.random((6, 8, 3))
    metric = {"constant": metrics[0, 0], "map": metrics, "weights": rng.random((9, 7))}[kind]
    source = lift(images[0], 1.0, color_metric=metric)
    target = lift(images[1], 1.0, color_metric=metric if kind == "constant" else None)
    got = sinkhorn(source, target, 0.1, 0.5, tol=1e-5, backend=device)
    want = reference.sinkhorn(source, target, 0.1, 0.5, tol=1e-7)
    # Both maps contract by the damping, so that an error is at most residual / (1 - damping).
    damping = 0.5**2 / (0.5**2 + 0.1**2)
    assert np.abs(got.f - want.f).max() < 1e-5 * got.epsilon / (1 - damping)
    assert got.primal == pytest.approx(want.primal, rel=1e-5)
    plan = transport_plan(source, target, got, relative=1e-9, backend=device).to_scipy().toarray()
    assert np.abs(plan - reference.transport_plan(source, target, want)).max() < 1e-3 * plan.max()


def test_a_map_of_equal_metrics_is_a_constant_one(rng):
    """And weighing color by pixel is the simplest map."""
    images = rng.random((9, 7, 3)), rng.random((6, 8, 3))
    options = {"n_frames": 2, "backend": "numpy", "tol": 1e-6}
    whole = plain.morph(*images, color_weight=1.4, **options)
    constant = 1.96 * np.eye(3)
    for metric in (constant, np.full((9, 7), 1.96), np.tile(constant, (9, 7, 1, 1))):
        other = plain.morph(*images, color_weight=1.0, color_metric=metric, **options)
        assert np.allclose(whole.potentials.f, other.potentials.f, atol=1e-7)
        assert np.abs(whole.frame(0.5) - other.frame(0.5)).max() < 1e-4


def test_barycentric_and_samples_with_a_map(device, rng, metrics):
    images = rng.random((9, 7, 3)), rng.random((6, 8, 3))
    usual = {"n_frames": 3, "color_weight": 1.0, "color_metric": metrics, "backend": device}
    for options in ({"barycentric": True}, {"sample": 4}):
        result = plain.morph(*images, **usual, **options)
        assert np.all(np.isfinite(result.frame(0.5)))


def test_where_a_map_has_no_meaning(rng, metrics):
    source = lift(rng.random((9, 7, 3)), color_metric=metrics)
    target = lift(rng.random((6, 8, 3)))
    with pytest.raises(InputError, match="divergence"):
        plain.sinkhorn_divergence(source, target, backend="numpy")
    with pytest.raises(InputError, match="source alone"):
        sinkhorn(target, source, backend="numpy")
    with pytest.raises(InputError, match="source alone"):
        sinkhorn(lift(np.zeros((2, 2)), color_metric=np.eye(3)), target, backend="numpy")
    with pytest.raises(InputError, match="of its own"):
        _ = source.points


@pytest.mark.parametrize("size", [0.0, 1.0, 1000.0])
def test_metrics_of_any_size(device, rng, size):
    """Products of large and small numbers are balanced before float32 has to hold them."""
    images = rng.random((8, 8, 3)), rng.random((8, 8, 3))
    source = lift(images[0], color_metric=size * rng.random((8, 8)))
    target = lift(images[1])
    got = sinkhorn(source, target, 0.03, 0.3, backend=device)
    assert got.converged
    want = sinkhorn(source, target, 0.03, 0.3, backend="numpy")
    assert got.transported_mass == pytest.approx(want.transported_mass, rel=1e-3)


def test_maps_of_one_pixel_and_metrics_that_hide_color(device, rng):
    image = rng.random((5, 5, 3))
    plain.morph(image[:1, :1], image, n_frames=2, color_metric=[[2.0]], backend=device)
    for metric in (np.zeros((3, 3)), np.diag([1.0, 1.0, 0.0])):
        with pytest.raises(InputError, match="no mean color"):
            plain.morph(image, image, barycentric=True, color_metric=metric, backend=device)
    tilted = np.array([[2.0, 1.0, 0.0], [1.0, 2.0, 0.5], [0.0, 0.5, 1.0]])
    result = plain.morph(
        image, image, barycentric=True, color_metric=tilted, color_space="lab", blur=0.02,
        n_frames=2, endpoints="paper", splatting="none", backend=device,
    )  # fmt: skip
    assert np.abs(result.frame(1.0) - image).max() < 0.01
