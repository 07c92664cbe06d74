"""Plans between blocks, solved at low resolution, become plans between pixels in bounded memory."""

import sys

import numpy as np
import plain
import pytest
from plain import lift

import clmorph
from clmorph import InputError, MemoryWarning
from clmorph.images.pixels import to_bytes
from clmorph.measures.pixel_blocks import group_pixels, solved_size
from clmorph.pipeline.memory import estimate
from clmorph.transport.plan_sampling import draw_pairs
from clmorph.transport.refine_plan import drawn, refined

SHAPES = [((16, 16), (16, 16)), ((13, 22), (9, 7)), ((8, 30), (21, 21)), ((5, 5), (20, 12))]


def blocks_of(rng, shapes, alpha=False):
    found = []
    for shape in shapes:
        image = rng.random((*shape, 4 if alpha else 3))
        if alpha:
            image[..., 3] = image[..., 3] > 0.3
        found.append(group_pixels(lift(image), 6))
    return found


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("shapes", SHAPES)
def test_blocks_keep_mass_and_means(rng, shapes, alpha):
    for blocks, shape in zip(blocks_of(rng, shapes, alpha=alpha), shapes, strict=True):
        fine, coarse = blocks.fine, blocks.coarse
        assert blocks.side & (blocks.side - 1) == 0
        assert max(coarse.shape) <= 6
        assert max(shape) <= 6 or 2 * max(coarse.shape) + 1 > 6  # no coarser than it must be
        assert coarse.mass == pytest.approx(fine.mass)
        for values in ("positions", "colors"):
            whole = fine.weights @ getattr(fine, values)
            assert np.allclose(coarse.weights @ getattr(coarse, values), whole)
        assert np.isfinite(coarse.points).all()


@pytest.mark.parametrize(
    ("shape", "size", "taken"),
    [((256, 192), 200, 128), ((256, 192), 256, 256), ((96, 80), 128, 96), ((300, 7), 100, 75)],
)
def test_the_size_that_is_really_solved(shape, size, taken):
    """Blocks have a power of two of pixels along a side: what is asked for is a bound."""
    assert solved_size(shape, size) == taken
    measure = lift(np.zeros((*shape, 3)))
    assert max(group_pixels(measure, size).coarse.shape) == taken


def solved(blocks, draws=None, barycentric=False):
    measures = [side.coarse for side in blocks]
    potentials = plain.sinkhorn(*measures, backend="numpy")
    if barycentric:
        return clmorph.barycentric_plan(*measures, potentials, backend="numpy")
    if draws:
        return draw_pairs(*measures, potentials, draws, backend="numpy")
    return clmorph.transport_plan(*measures, potentials, backend="numpy")


def by_blocks(plan, blocks):
    """A plan between pixels, summed up between their blocks."""
    owners = [side.owners for side in blocks]
    shape = [len(side.coarse) for side in blocks]
    dense = np.zeros(shape)
    np.add.at(dense, (owners[0][plan.rows], owners[1][plan.indices]), plan.mass)
    return dense


def shared(masses, side):
    """Masses of blocks, shared out among their pixels by these pixels' own."""
    weights = side.coarse.weights[side.owners]
    return masses[side.owners] * side.fine.weights / weights.clip(1e-300)


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("shapes", SHAPES)
def test_a_refined_plan_is_the_plan_between_blocks(rng, shapes, alpha):
    blocks = blocks_of(rng, shapes, alpha=alpha)
    plan = solved(blocks)
    fine = refined(plan, *blocks)
    assert fine.shape == tuple(len(side.fine) for side in blocks)
    assert np.allclose(by_blocks(fine, blocks), plan.to_scipy().toarray())
    assert fine.total_mass == pytest.approx(plan.total_mass)
    source, target = (side.fine for side in blocks)
    assert np.all(source.weights[fine.rows] > 0)
    assert np.all(target.weights[fine.indices] > 0)
    pixels = fine.rows, fine.indices
    for side, own, marginal, whole in zip(
        blocks, pixels, fine.marginals, plan.marginals, strict=True
    ):
        assert np.array_equal(np.unique(own), np.flatnonzero(marginal))
        assert np.allclose(marginal, shared(whole, side))
    if not alpha and shapes[0] == (16, 16):
        # Every pixel of a cell as much as the next one, and to the place that is its own.
        rows = fine.row_mass.reshape(4, 4, 4, 4).transpose(0, 2, 1, 3).reshape(16, 16)
        assert np.allclose(rows, rows[:, :1])
        for own in pixels:
            assert np.array_equal(np.unique(own), np.arange(256))
        assert np.array_equal(fine.rows // 16 % 4, fine.indices // 16 % 4)
        assert np.array_equal(fine.rows % 4, fine.indices % 4)


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("shapes", SHAPES)
def test_draws_are_shared_out_among_the_pixels(rng, shapes, alpha):
    blocks = blocks_of(rng, shapes, alpha=alpha)
    finest = max(side.side for side in blocks) ** 2
    draws = solved(blocks, draws=(2 * finest, finest))
    fine = drawn(draws, *blocks)
    coarse = np.zeros([len(side.coarse) for side in blocks])
    masses = draws.masses()
    np.add.at(coarse, (np.arange(len(coarse))[:, None], draws.targets), masses[0])
    np.add.at(coarse, (draws.sources, np.arange(coarse.shape[1])[:, None]), masses[1])
    assert np.allclose(by_blocks(fine, blocks), coarse)
    marginals, kept = (draws.row_mass, draws.column_mass), (fine.row_mass, fine.column_mass)
    for side, got, whole, own in zip(blocks, fine.marginals, marginals, kept, strict=True):
        # By mass, and every pixel that has some moves.
        assert np.allclose(got, shared(whole, side))
        assert np.all(own[shared(whole, side) > 0] > 0)
    source, target = (side.fine for side in blocks)
    moving = clmorph.particles(source, target, fine)
    assert moving.mass(0.0) == pytest.approx(source.mass)
    assert moving.mass(1.0) == pytest.approx(target.mass)


def test_means_move_as_the_blocks_around(rng):
    blocks = blocks_of(rng, SHAPES[0])
    plan = solved(blocks, barycentric=True)
    fine = refined(plan, *blocks)
    moved = fine.positions - blocks[0].fine.positions
    assert np.abs(moved).max() <= np.abs(plan.positions - blocks[0].coarse.positions).max() + 1e-9
    assert fine.row_mass.sum() == pytest.approx(plan.row_mass.sum())
    assert fine.column_mass.sum() == pytest.approx(plan.column_mass.sum())
    inner = moved.reshape(16, 16, 2)[1:-1, 1:-1]
    coarse = (plan.positions - blocks[0].coarse.positions).reshape(4, 4, 2)
    step = max(np.abs(np.diff(coarse, axis=axis)).max() for axis in (0, 1)) / 4
    assert max(np.abs(np.diff(inner, axis=axis)).max() for axis in (0, 1)) <= step * 1.01


@pytest.mark.parametrize("options", [{}, {"sample": 2}, {"barycentric": True}])
@pytest.mark.parametrize("shapes", SHAPES[:2])
def test_a_morph_has_all_the_pixels(device, rng, shapes, options):
    images = [rng.random((*shape, 3)) for shape in shapes]
    result = plain.morph(*images, 5, solve_size=6, backend=device, splatting="local", **options)
    assert len(result.source) == shapes[0][0] * shapes[0][1]
    assert result.plan.row_mass.shape == (len(result.source),)
    for frame, image in ((result.frames[0], images[0]), (result.frames[-1], images[1])):
        assert np.abs(to_bytes(frame).astype(int) - to_bytes(image)).max() <= 1
    assert all(np.isfinite(frame).all() for frame in result.frames)


def test_the_same_picture_stays(device, rng):
    """PixelBlocks that stay keep their pixels in place: nothing is blurred by solving low."""
    image = rng.random((16, 16, 3))
    result = plain.morph(
        image, image, 3, solve_size=4, blur=0.01, backend=device, splatting="none",
        endpoints="paper",
    )  # fmt: skip
    assert np.abs(result.frames[1] - image).max() < 1e-3


def test_solving_at_full_size_changes_nothing(device, rng):
    images = rng.random((2, 8, 8, 3))
    whole, same = (plain.morph(*images, 3, solve_size=size, backend=device) for size in (None, 8))
    assert np.array_equal(whole[1], same[1])


def test_too_little_memory_is_said(device, rng, monkeypatch):
    images = rng.random((2, 32, 32, 3))
    whole = plain.morph(*images, 3, 0.3, backend=device)
    need = estimate(2048, (1024, 1024), len(whole.plan), device, frame=1024)
    limit = 0.6 * max(need.needs)
    options = plain.OPTIONS.replace(n_frames=3, blur=0.3, max_memory=limit)
    with pytest.warns(MemoryWarning, match="sample=") as told:
        fewer = clmorph.morph(*images, options, backend=device)
    assert f"max_memory={limit / 1e9:.3g} GB" in str(told[0].message)
    assert told[0].filename == __file__
    assert len(fewer.particles) < len(whole.particles)
    # Before anything is solved.
    monkeypatch.setattr(sys.modules["clmorph.pipeline.morph"], "sinkhorn", None)
    for options in ({}, {"sample": 4096}, {"barycentric": True}):
        with pytest.raises(InputError, match=r"max_memory=0\.0001 GB: expected at least"):
            plain.morph(*images, 3, backend=device, max_memory=1e5, **options)


def test_as_many_draws_as_there_can_be(rng):
    """At the cap, and above it, with blocks: all pixels have some, or one line says why not."""
    images = rng.random((2, 12, 12, 3))
    whole = plain.morph(*images, 3, solve_size=6, sample=1024, backend="numpy")
    assert whole.plan.shape == (144, 144)
    with pytest.raises(InputError, match="sample=1025: expected at most 1024 with blocks of 4"):
        plain.morph(*images, 3, solve_size=6, sample=1025, backend="numpy")


def test_particles_are_limited(device, rng):
    images = rng.random((2, 16, 16, 3))
    whole = plain.morph(*images, 3, 0.3, backend=device)
    most = len(whole.plan) // 3
    # Without a warning, as it was asked for.
    fewer, least, enough = (
        plain.morph(*images, 3, 0.3, backend=device, max_particles=count)
        for count in (most, 1, 10 * len(whole.plan))
    )
    assert most / 4 < len(fewer.plan) <= most  # what is drawn twice is one pair
    assert 256 <= len(least.plan) <= 2 * 256  # each pixel of both has one
    assert len(enough.plan) == len(whole.plan)


def test_mistakes(rng):
    images = rng.random((2, 8, 8, 3))
    metric = np.ones((8, 8))
    for options, words in (
        ({"solve_size": 1}, "solve_size=1"),
        ({"solve_size": 2.5}, "solve_size=2.5"),
        ({"max_particles": 0}, "max_particles=0"),
        ({"max_memory": 0}, "max_memory=0"),
        ({"max_memory": -1}, "max_memory=-1"),
        ({"solve_size": 4, "color_metric": metric}, "give solve_size=None"),
    ):
        with pytest.raises(InputError, match=words):
            plain.morph(*images, 3, backend="numpy", **options)
