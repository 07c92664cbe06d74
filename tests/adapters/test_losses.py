"""The interfaces of PyTorch, JAX and GeomLoss; tests of a library that is absent are skipped."""

import subprocess
import sys

import numpy as np
import pytest

import clmorph
import clmorph.geomloss
import clmorph.jax
import clmorph.torch
from clmorph import InputError


def arrays(rng, n=5, m=6, balanced=False):
    a, b = rng.uniform(0.5, 1.5, n), rng.uniform(0.5, 1.5, m)
    if balanced:
        a, b = a / a.sum(), b / b.sum()
    return a, rng.random((n, 2)), b, rng.random((m, 2))


def test_interfaces_import_no_library_and_need_no_driver():
    code = (
        "import sys, clmorph, clmorph.torch, clmorph.jax, clmorph.pot, clmorph.geomloss;"
        "assert not {'torch', 'jax', 'ot', 'geomloss', 'pyopencl', 'skimage'} & set(sys.modules);"
        "assert clmorph.torch is sys.modules['clmorph.torch']"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("reach", [0.4, None])
def test_gradcheck(rng, reach):
    torch = pytest.importorskip("torch")
    tensors = [torch.tensor(each) for each in arrays(rng, balanced=reach is None)]
    for each in tensors if reach else tensors[1::2]:
        each.requires_grad_()
    options = {"blur": 0.3, "reach": reach, "tol": 1e-8, "backend": "numpy"}
    assert torch.autograd.gradcheck(
        lambda *given: clmorph.torch.sinkhorn_divergence(*given, **options), tensors
    )


@pytest.mark.parametrize("reach", [0.4, None])
def test_double_backward(rng, reach):
    torch = pytest.importorskip("torch")
    balanced = reach is None
    drawn = [arrays(rng, 3, 2, balanced) for _ in range(2)]
    many = [np.stack(each) for each in zip(*drawn, strict=True)]
    for given in (drawn[0], many):
        tensors = [torch.tensor(each) for each in given]
        for each in tensors[1::2] if balanced else tensors:
            each.requires_grad_()
        options = {"blur": 0.3, "reach": reach, "tol": 1e-10, "backend": "numpy"}
        assert torch.autograd.gradgradcheck(
            lambda *there, options=options: clmorph.torch.sinkhorn_divergence(*there, **options),
            tensors, rtol=1e-5,
        )  # fmt: skip


def test_torch_curvature_on_devices(device, rng):
    torch = pytest.importorskip("torch")
    a, x, b, y = (torch.tensor(each) for each in arrays(rng))
    x.requires_grad_()
    direction = torch.tensor(rng.standard_normal(x.shape))
    found = []
    for backend in (device, "numpy"):
        value = clmorph.torch.sinkhorn_divergence(a, x, b, y, 0.3, 0.5, backend=backend)
        (slope,) = torch.autograd.grad(value, x, create_graph=True)
        found.append(torch.autograd.grad(slope, x, direction)[0])
    np.testing.assert_allclose(found[0], found[1], atol=1e-3 * float(found[1].abs().max()))


def test_torch_batches(any_backend, rng):
    torch = pytest.importorskip("torch")
    many = [np.stack(each) for each in zip(arrays(rng), arrays(rng), strict=True)]
    tensors = [torch.tensor(each, dtype=torch.float32, requires_grad=True) for each in many]
    values = clmorph.torch.sinkhorn_divergence(*tensors, 0.3, 0.5, backend=any_backend)
    (values * torch.tensor([1.0, 2.0])).sum().backward()
    for number, factor in enumerate((1.0, 2.0)):
        a, x, b, y = (each[number] for each in many)
        want = clmorph.sinkhorn_divergence(
            (a, x), (b, y), 0.3, 0.5, 1e-6, backend=any_backend, gradient=True
        )
        assert values[number].item() == pytest.approx(want.value, rel=1e-5)
        got = tensors[1].grad[number].numpy()
        np.testing.assert_allclose(got, factor * want.gradient.source_points, atol=1e-5)
    with pytest.raises(InputError, match="shapes"):
        clmorph.torch.sinkhorn_divergence(tensors[0], *tensors[:3], backend="numpy")
    with pytest.raises(InputError, match="tensor of floats"):
        clmorph.torch.sinkhorn_divergence(*many, backend="numpy")


def test_geomloss_losses(rng):
    with pytest.raises(InputError, match="p is not 2"):
        clmorph.geomloss.SamplesLoss(p=1)
    torch = pytest.importorskip("torch")
    a, x, b, y = (torch.tensor(each, requires_grad=True) for each in arrays(rng))
    loss = clmorph.geomloss.SamplesLoss(blur=0.3, reach=0.5, device="numpy")
    want = clmorph.torch.sinkhorn_divergence(a, x, b, y, 0.3, 0.5, backend="numpy")
    assert loss(a, x, b, y).item() == want.item()
    even = loss(torch.ones(5) / 5, x, torch.ones(6) / 6, y)
    assert loss(x, y).item() == pytest.approx(even.item(), rel=1e-5)
    with pytest.raises(InputError, match="3 tensors"):
        loss(a, x, b)
    original = pytest.importorskip("geomloss").SamplesLoss(blur=0.3, reach=0.5, scaling=0.99)
    assert loss(a, x, b, y).item() == pytest.approx(original(a, x, b, y).item(), rel=1e-3)


def test_jax(any_backend, rng):
    jax = pytest.importorskip("jax")
    given = arrays(rng)

    def loss(x, y):
        a, b = given[::2]
        return clmorph.jax.sinkhorn_divergence(a, x, b, y, 0.3, 0.5, backend=any_backend)

    want = clmorph.sinkhorn_divergence(
        given[:2], given[2:], 0.3, 0.5, 1e-6, backend=any_backend, gradient=True
    )
    value, found = jax.jit(jax.value_and_grad(loss, (0, 1)))(given[1], given[3])
    assert float(value) == pytest.approx(want.value, rel=1e-5)
    for got, name in zip(found, ("source_points", "target_points"), strict=True):
        exact = getattr(want.gradient, name)
        np.testing.assert_allclose(got, exact, atol=1e-4 * np.abs(exact).max())
    with pytest.raises(InputError, match="shapes"):
        loss(given[0], given[3])
    with pytest.raises(InputError, match="blur=-1"):
        clmorph.jax.sinkhorn_divergence(*given, -1)
    rough = clmorph.jax.sinkhorn_divergence(*(jax.numpy.bfloat16(each) for each in given), 0.3, 0.5)
    assert float(rough) == pytest.approx(want.value, rel=0.1)
    for many in (given, [np.stack([each] * 2) for each in given]):
        with pytest.raises(InputError, match="a coordinate is nan"):
            clmorph.jax.sinkhorn_divergence(many[0], many[1] * np.nan, *many[2:], 0.3)
    both = jax.vmap(loss, (0, None))(np.stack([given[1]] * 2), given[3])
    np.testing.assert_allclose(both, [want.value] * 2, rtol=1e-5)


@pytest.mark.parametrize("reach", [0.5, None])
def test_jax_second_derivatives(any_backend, rng, reach):
    """The derivative of a derivative along a direction, compiled, beside the product itself."""
    jax = pytest.importorskip("jax")
    a, x, b, y = arrays(rng, balanced=reach is None)
    change = rng.standard_normal(x.shape)
    options = {"blur": 0.3, "reach": reach, "tol": 1e-6}

    def slope(x, y):
        def loss(x):
            found = clmorph.jax.sinkhorn_divergence(a, x, b, y, **options, backend=any_backend)
            return found**2  # whose own second derivative counts too

        return (jax.grad(loss)(x) * change).sum()

    found = jax.jit(jax.grad(slope, (0, 1)))(x, y)
    solved = clmorph.sinkhorn_divergence(
        (a, x), (b, y), **options | {"tol": 1e-9}, gradient=True, backend="numpy"
    )
    along = clmorph.Gradient(change, np.zeros(len(a)), np.zeros(y.shape), np.zeros(len(b)))
    product = clmorph.hessian_product((a, x), (b, y), solved, along)
    first = (solved.gradient.source_points * change).sum()
    for got, name in zip(found, ("source_points", "target_points"), strict=True):
        want = 2 * solved.value * getattr(product, name)
        want = want + 2 * first * getattr(solved.gradient, name)
        assert np.abs(np.asarray(got) - want).max() <= 1e-3 * np.abs(want).max()


@pytest.mark.full
@pytest.mark.parametrize("reach", [0.5, None])
def test_jax_modes(rng, reach):
    """Each mode, and each pair of modes, beside differences; compiled, mapped, and in batches."""
    jax = pytest.importorskip("jax")
    a, x, b, y = arrays(rng, 2, 3, balanced=reach is None)
    change, step = rng.standard_normal(x.shape), 1e-3
    options = {"blur": 0.3, "reach": reach, "tol": 1e-11, "backend": "numpy"}

    def loss(x):
        return clmorph.jax.sinkhorn_divergence(a, x, b, y, **options)

    def difference(function):
        # The error is of the step's fourth power.
        weights = (1, -8), (-1, 8), (2, 1), (-2, -1)
        return -sum(w * np.asarray(function(x + k * step * change)) for k, w in weights) / 12 / step

    def along(function, *given):
        return jax.jvp(function, given, (change,))[1]

    with jax.enable_x64(True):
        want = difference(loss), difference(jax.grad(loss))
        np.testing.assert_allclose(jax.jit(lambda x: along(loss, x))(x), want[0], rtol=1e-6)
        found = [jax.jit(jax.hessian(loss))(x)]
        found += [one(other(loss))(x) for one in (jax.jacfwd, jax.jacrev)
                  for other in (jax.jacfwd, jax.jacrev)]  # fmt: skip
        found.append(jax.vmap(jax.hessian(loss))(np.stack([x, x]))[1])
        found.append(jax.vmap(lambda x: along(jax.jacrev(loss), x))(np.stack([x, x])))
        allowed = 1e-6 * np.abs(want[1]).max()
        for each in found[:-1]:
            product = np.einsum("ijkl,kl->ij", each, change)
            np.testing.assert_allclose(product, want[1], atol=allowed)
        np.testing.assert_allclose(found[-1], [want[1]] * 2, atol=allowed)
        many = [np.stack([each, each]) for each in (a, x, b, y)]
        slopes = jax.jvp(
            lambda x: clmorph.jax.sinkhorn_divergence(many[0], x, *many[2:], **options),
            (many[1],), (np.stack([change, 0 * change]),),
        )[1]  # fmt: skip
        np.testing.assert_allclose(slopes, [want[0], 0.0], rtol=1e-6, atol=1e-12)
        # A third derivative that is silently 0 would be wrong.
        with pytest.raises(ValueError, match="JVP"):
            along(jax.hessian(loss), x)
