"""Groups of particles that are drawn together are as those drawn one by one."""

import numpy as np
import pytest

import clmorph
from clmorph.frames import sprites as module
from clmorph.frames.canvas import canvas_at
from clmorph.frames.sprites import Parts


@pytest.mark.small
@pytest.mark.parametrize("sigma", [0.45, 1.3])
def test_together_and_one_by_one(any_backend, monkeypatch, rng, sigma):
    ends = rng.random((9, 12, 3)), rng.random((14, 10, 3))
    particles = clmorph.morph(*ends, n_frames=2, preset="paper", backend="numpy").particles
    shuffled = rng.permutation(len(particles.links))
    groups = np.split(shuffled, [1, 5, 300, 301])
    for t in (0.0, 0.3, 1.0):
        canvas = canvas_at(t, *(end.shape[:2] for end in ends))
        found = []
        # All by themselves; all together; at most two in a splat.
        for large, most in ((1, 2**22), (10**9, 2**22), (10**9, 2 * canvas.shape[1] * 25)):
            monkeypatch.setattr(module, "LARGE", large)
            monkeypatch.setattr(module, "LARGEST_SPLAT", most)
            drawn = Parts(clmorph.get_backend(any_backend), particles, particles.table, groups)
            found.append([np.dstack(each) for each in drawn.drawn(t, canvas, sigma)])
            assert len(found[-1]) == len(groups)
        for alone, *together in zip(*found, strict=True):
            for other in together:
                density = alone[..., 3]
                np.testing.assert_allclose(other[..., 3], density, atol=1e-4 * density.max())
                thick = density > 1e-3 * density.max()  # the color of nothing is arbitrary
                np.testing.assert_allclose(other[thick][:, :3], alone[thick][:, :3], atol=1e-3)
        total = sum(each[..., 3] for each in found[0])
        assert total.mean() == pytest.approx(1.0, abs=0.35)  # relative to an even spread


@pytest.mark.full
def test_many_groups_on_a_tall_canvas(any_backend, rng):
    """Positions far down in the strip keep their precision."""
    options = {"n_frames": 2, "preset": "paper", "size": None, "extent": "true"}
    ends = rng.random((2, 250, 3, 3))
    particles = clmorph.morph(*ends, **options, backend="numpy").particles
    groups = np.array_split(np.arange(len(particles.links)), 200)
    canvas = canvas_at(0.3, (250, 3), (250, 3))
    backend = clmorph.get_backend(any_backend)

    def densities(some):
        drawn = Parts(backend, particles, particles.table, some).drawn(0.3, canvas, 0.7)
        return [density for _, density in drawn]

    together = densities(groups)
    there = [number for number, density in enumerate(together) if density.max() > 0]
    assert len(there) > 100
    for number in there[-2:]:
        (alone,) = densities(groups[number : number + 1])
        assert np.abs(together[number] - alone).max() < 5e-4 * alone.max(), number
