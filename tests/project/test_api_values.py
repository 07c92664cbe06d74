"""Any value of any argument of a public function gives a result or an error of clmorph."""

import dataclasses
import inspect
from concurrent.futures import ThreadPoolExecutor
from decimal import Decimal
from fractions import Fraction
from functools import partial
from pathlib import Path

import api_values
import numpy as np
import pytest
from api_values import cases, check, public_functions, single
from marks import full

import clmorph
from clmorph import InputError
from clmorph.backends.interface import MAX_DIMENSION

FUNCTIONS = public_functions()
#: Those that take longest; the others show by default how values are checked.
SLOW = "quality.film_measures", "inspect", "Inspection.save", "mix", "barycenter"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty working directory with a picture and a morph to read."""
    monkeypatch.chdir(tmp_path)
    api_values.furnish()
    return tmp_path


def test_no_function_and_no_argument_is_forgotten():
    given = cases()
    assert set(FUNCTIONS) == set(given), set(FUNCTIONS) ^ set(given)
    for name, function in FUNCTIONS.items():
        parameters = inspect.signature(function).parameters.values()
        wanted = {each.name for each in parameters if each.kind is not each.VAR_KEYWORD}
        if len(wanted) == len(parameters):
            assert set(given[name]) == wanted, name
        else:
            assert set(given[name]) >= wanted, name
    for name in clmorph.__all__:
        value = getattr(clmorph, name)
        assert not callable(value) or name in FUNCTIONS or isinstance(value, type)


@pytest.mark.filterwarnings("ignore::clmorph.ConvergenceWarning")
@pytest.mark.in_turns
@pytest.mark.parametrize("name", [*full(*SLOW), *(it for it in FUNCTIONS if it not in SLOW)])
def test_every_value_of_every_argument(name):
    check(name, api_values._call(FUNCTIONS[name], cases()[name], {}))
    messages = [check(description, call) for description, call in single(name, every=16)]
    if set(cases()[name]) - {"self"}:
        assert any(messages)


# --- numbers --------------------------------------------------------------------------------

A = np.linspace(0.0, 1.0, 27).reshape(3, 3, 3)
B = A[::-1] ** 2
POINTS = np.array([[0.0, 0.1], [0.5, 0.2], [0.9, 1.0], [0.3, 0.3]])
OTHERS = np.array([[0.2, 0.0], [0.6, 0.7], [1.0, 0.9]])
PLAIN = (np.array([0.4, 0.3, 0.2, 0.1]), POINTS), (np.array([0.5, 0.25, 0.25]), OTHERS)


def test_numbers_of_any_kind_are_the_same_number(tmp_path):
    """The value stands in the result, and in the parameters of a file as JSON."""
    plain = clmorph.morph(
        A, B, n_frames=2, blur=0.0625, reach=(0.5, None), color_weight=1.5, splatting="adaptive",
        gamma=0.25, tol=0.5, sample=3, seed=7, max_particles=64, max_memory=1e9, backend="numpy",
    )  # fmt: skip
    odd = clmorph.morph(
        A, B, n_frames=np.array(2), blur=Decimal("0.0625"), reach=(Fraction(1, 2), np.inf),
        color_weight=np.float32(1.5), splatting="adaptive", gamma=np.array(0.25),
        tol=np.float16(0.5), sample=Decimal(3), seed=np.uint8(7), max_particles=Fraction(64),
        max_memory=np.longdouble(1e9), backend="numpy",
    )  # fmt: skip
    assert np.array_equal(plain.frames, odd.frames)
    assert odd.options == plain.options
    odd.save(tmp_path / "odd.npz")
    assert clmorph.load_options(tmp_path / "odd.npz") == plain.options.as_dict()


def test_seeds_are_exact():
    """Neighbors that float64 cannot tell apart draw differently."""
    source, target = PLAIN
    potentials = clmorph.sinkhorn(source, target, 0.5, backend="numpy")
    given = source, target, potentials, 200
    drawn = [clmorph.sample_plan(*given, seed=2**60 + add, backend="numpy") for add in (0, 1)]
    assert not np.array_equal(drawn[0].mass, drawn[1].mass)


# --- measures -------------------------------------------------------------------------------


def test_the_neighbors_of_sinkhorn_take_what_it_takes():
    """Plain points all the way; the streamed means are those of the dense plan."""
    potentials = clmorph.sinkhorn(*PLAIN, 0.2, backend="numpy")
    dense = clmorph.reference.transport_plan(*PLAIN, potentials)
    plan = clmorph.transport_plan(*PLAIN, potentials, relative=1e-12, backend="numpy")
    assert np.allclose(plan.to_scipy().toarray(), dense, rtol=1e-9)
    means = clmorph.barycentric_plan(*PLAIN, potentials, backend="numpy")
    wanted = dense @ OTHERS / dense.sum(axis=1, keepdims=True)
    assert np.allclose(means.positions, wanted, rtol=1e-9)
    assert means.colors.shape == (4, 0)
    assert np.allclose(means.column_mass, dense.sum(axis=0), rtol=1e-6)
    assert np.allclose(plan.mean_destinations(POINTS.tolist(), OTHERS)[0], wanted, rtol=1e-9)
    draws = clmorph.sample_plan(*PLAIN, potentials, 4, backend="numpy")
    assert draws.total_mass == pytest.approx(dense.sum())
    assert clmorph.sinkhorn_divergence(*PLAIN, backend="numpy").value > 0
    assert clmorph.reference.cost_matrix(*PLAIN).shape == (4, 3)


def test_what_needs_an_image_says_so():
    potentials = clmorph.sinkhorn(*PLAIN, backend="numpy")
    plan = clmorph.transport_plan(*PLAIN, potentials, backend="numpy")
    with pytest.raises(InputError, match=r"clmorph\.lift.*mean_destinations"):
        clmorph.displacement_statistics(*PLAIN, plan)
    with pytest.raises(InputError, match=r"positions and colors.*clmorph\.lift"):
        clmorph.particles(*PLAIN, plan)


@pytest.mark.parametrize(
    "function", [clmorph.transport_plan, clmorph.barycentric_plan, clmorph.reference.transport_plan]
)
def test_wrong_potentials(function):
    source, target = PLAIN
    potentials = clmorph.sinkhorn(source, target, backend="numpy")
    options = {} if function is clmorph.reference.transport_plan else {"backend": "numpy"}
    for wrong, words in (
        (None, "expected Potentials"),
        ((potentials.f, potentials.g), "expected Potentials"),
        (potentials.swapped(), "3 and 4 points; expected 4 and 3"),
        (dataclasses.replace(potentials, f=potentials.f * np.nan), "NaN"),
        (dataclasses.replace(potentials, g=list(potentials.g)), "float64"),
    ):
        with pytest.raises(InputError, match=words):
            function(source, target, wrong, **options)


def test_potentials_of_other_measures_of_the_same_sizes():
    source, target = PLAIN
    potentials = clmorph.sinkhorn(source, target, backend="numpy")
    elsewhere = source[0], source[1] + 0.05
    heavier = 1.1 * source[0], source[1]
    for other in (elsewhere, heavier):
        draw = partial(clmorph.sample_plan, draws=2)
        for function in (clmorph.transport_plan, draw, clmorph.barycentric_plan):
            with pytest.raises(InputError, match="of other measures"):
                function(other, target, potentials, backend="numpy")


def test_measures_that_callers_made_are_checked():
    source, target = clmorph.lift(A), clmorph.lift(B)
    made = clmorph.WeightedPoints(POINTS.tolist(), [1, 2, 3, 4])
    assert clmorph.sinkhorn(made, PLAIN[1], reach=0.3, backend="numpy").converged
    for wrong, words in (
        (dataclasses.replace(source, weights=-source.weights), "at least 0"),
        (dataclasses.replace(source, colors=source.colors * np.nan), "colors"),
        (dataclasses.replace(source, positions=source.positions[:4]), "positions"),
        (clmorph.WeightedPoints(POINTS, np.full(4, np.nan)), "at least 0"),
        (clmorph.WeightedPoints(POINTS, PLAIN[0][0], np.full(4, np.inf)), "offsets"),
    ):
        with pytest.raises(InputError, match=words):
            clmorph.sinkhorn(wrong, target, backend="numpy")


def test_a_measure_is_not_changed_by_what_its_maker_does_later():
    weights, points = PLAIN[0][0].copy(), POINTS.copy()
    lifted = clmorph.lift(np.eye(2), weights=(given := np.ones((2, 2))))
    given[:] = 0
    assert lifted.mass == 4
    potentials = clmorph.sinkhorn((weights, points), PLAIN[1], backend="numpy")
    weights[:], points[:] = 1.0, 0.0
    assert np.array_equal(potentials.f, clmorph.sinkhorn(*PLAIN, backend="numpy").f)


# --- arrays ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [np.ndarray.tolist, np.asfortranarray, lambda a: a.astype(">f8"), api_values.Frame,
     lambda a: np.repeat(a, 2, axis=0)[::2], lambda a: np.ma.array(a), lambda a: a.astype(object),
     lambda a: a.astype(np.longdouble), api_values.read_only],
    ids=["list", "Fortran", "big-endian", "frame", "strided", "unmasked", "objects", "longdouble",
         "read-only"],
)  # fmt: skip
def test_an_array_in_any_form_is_the_same_array(change):
    """As image, weights, map of a metric, points."""
    image, weights, metric = np.round(A, 3), np.arange(1.0, 10.0).reshape(3, 3), np.eye(3) + 1.0
    plain = clmorph.lift(image, weights=weights, color_metric=metric)
    # An image's dtype says what its values mean; an object's is none, and is taken as floats.
    other = clmorph.lift(change(image), weights=change(weights), color_metric=change(metric))
    for part in ("positions", "colors", "weights", "points"):
        assert np.array_equal(getattr(plain, part), getattr(other, part)), part
    want = clmorph.sinkhorn(*PLAIN, backend="numpy")
    source = change(PLAIN[0][0]), change(POINTS)
    assert np.array_equal(clmorph.sinkhorn(source, PLAIN[1], backend="numpy").f, want.f)
    large = np.arange(9, dtype=np.uint16).reshape(3, 3) * 7000
    assert np.array_equal(clmorph.fit(large.astype(">u2"), 9), clmorph.fit(large, 9))


HOLES = np.ma.array(A, mask=A > 0.9)
FLAT = np.ma.array(np.eye(3), mask=np.eye(3) > 0)
MASKED = {
    "image": lambda: clmorph.lift(HOLES),
    "image to fit": lambda: clmorph.fit(HOLES, 2),
    "rows of an image": lambda: clmorph.lift(list(HOLES)),
    "image_a": lambda: clmorph.morph(HOLES, B, backend="numpy"),
    "image_b": lambda: clmorph.inspect(A, HOLES, backend="numpy"),
    "channels": lambda: clmorph.analysis.channel_baseline.channel_morph(A, HOLES, backend="numpy"),
    "the reference's": lambda: clmorph.reference.morph(A, HOLES),
    "weights": lambda: clmorph.lift(A, weights=FLAT),
    "a pair's weights": lambda: clmorph.morph(A, B, weights=(FLAT, None), backend="numpy"),
    "metric": lambda: clmorph.lift(A, color_metric=FLAT),
    "a pair's metric": lambda: clmorph.morph(A, B, color_metric=FLAT, backend="numpy"),
    "masses": lambda: clmorph.sinkhorn((FLAT[0], OTHERS), PLAIN[1], backend="numpy"),
    "points": lambda: clmorph.sinkhorn((np.ones(3), FLAT), PLAIN[1], backend="numpy"),
    "coverage": lambda: clmorph.analysis.metrics.hole_fraction(FLAT),
    "frame": lambda: clmorph.analysis.metrics.sharpness(HOLES),
    "frames": lambda: clmorph.analysis.metrics.step_sizes([A, HOLES]),
    "times": lambda: clmorph.analysis.metrics.path_divergence(
        api_values.examples()["morph"], FLAT[0]
    ),
    "the reference's plan": lambda: clmorph.reference.render(
        clmorph.lift(A[0]), clmorph.lift(B[0]), np.ma.array(np.ones((9, 9)), mask=True), 0.5, 1.0
    ),
}


@pytest.mark.parametrize("call", MASKED.values(), ids=list(MASKED))
def test_masked_entries_are_refused_everywhere(call):
    with pytest.raises(InputError, match="masked"):
        call()


# --- dimensions -----------------------------------------------------------------------------


def test_dimensions_are_as_many_as_is_said(rng):
    most = MAX_DIMENSION
    page = Path(__file__).parents[2] / "clmorph/transport/README.md"
    assert f"1 to {most:,} dimensions" in page.read_text("utf-8")
    assert f"D from 1 to {most:,}." in clmorph.sinkhorn.__doc__
    assert f"any dimension up to {most:,}" in clmorph.measures.points.__doc__
    for dimension in (1, most):
        pair = [(np.ones(5), rng.random((5, dimension))) for _ in range(2)]
        assert clmorph.sinkhorn(*pair, 0.5, backend="numpy").converged
    pair = [(np.ones(5), rng.random((5, most + 1))) for _ in range(2)]
    with pytest.raises(InputError, match=f"in {most + 1} dimensions: .* 1 to {most} dimensions"):
        clmorph.sinkhorn(*pair, backend="numpy")


# --- threads --------------------------------------------------------------------------------


def test_one_morph_is_rendered_by_many_threads():
    rng = np.random.default_rng(0)
    images = rng.random((6, 6, 4)), rng.random((6, 5, 4))
    result = clmorph.morph(*images, n_frames=8, backend="numpy")
    fresh = dataclasses.replace(result)
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(fresh.frame, result.times))
    assert all(map(np.array_equal, result.frames, together))


# --- progress -------------------------------------------------------------------------------


@pytest.mark.parametrize("progress", [5, "x", [], False])
def test_progress_must_be_callable(progress):
    morph = api_values.examples()["morph"]
    for call in (
        lambda: clmorph.morph(A, B, backend="numpy", progress=progress),
        lambda: clmorph.inspect(A, B, backend="numpy", progress=progress),
        lambda: clmorph.sinkhorn(*PLAIN, backend="numpy", progress=progress),
        lambda: clmorph.sinkhorn_divergence(*PLAIN, backend="numpy", progress=progress),
        lambda: clmorph.analysis.metrics.path_divergence(morph, [0.5], progress=progress),
        lambda: morph.save("x.png", progress=progress),
    ):
        with pytest.raises(InputError, match=r"progress=.*function"):
            call()
