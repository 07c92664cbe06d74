"""Results of the solver in ``.npz`` files, and habits of other libraries that are understood."""

import pickle

import numpy as np
import pytest

import clmorph
from clmorph.errors import InputError


@pytest.fixture(scope="module")
def solved():
    rng = np.random.default_rng(0)
    x, y = rng.random((7, 2)), rng.random((9, 2))
    options = {"blur": 0.2, "reach": 0.4, "backend": "numpy"}
    potentials = clmorph.sinkhorn(x, y, **options)
    return {
        "points": (x, y),
        "options": options,
        "potentials": potentials,
        "plan": clmorph.transport_plan(x, y, potentials, backend="numpy"),
        "divergence": clmorph.sinkhorn_divergence(x, y, **options, gradient=True),
        "batch": clmorph.sinkhorn_batch(
            [(np.ones(7), x), (np.ones(9), y)], [(np.ones(9), y)] * 2, **options
        ),
        "assignment": clmorph.assignment(x, y, backend="numpy"),
    }


def _same(one, other):
    """Whether two results have equal fields, but for those that are not kept."""
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other)
    if isinstance(one, clmorph.PotentialsBatch | tuple):
        return type(one) is type(other) and len(one) == len(other) and all(map(_same, one, other))
    if hasattr(one, "__dataclass_fields__"):
        names = set(one.__dataclass_fields__) - {"measures", "passes"}
        return type(one) is type(other) and all(
            _same(getattr(one, name), getattr(other, name)) for name in names
        )
    return one == other


@pytest.mark.parametrize("name", ["potentials", "plan", "divergence", "batch", "assignment"])
def test_saved_and_loaded(solved, name, tmp_path):
    for path in (tmp_path / "one.npz", tmp_path / "two.npz"):
        clmorph.save(solved[name], path)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    assert _same(solved[name], clmorph.load(tmp_path / "one.npz"))
    with np.load(tmp_path / "one.npz", allow_pickle=False) as arrays:
        assert all(arrays[each].dtype != object for each in arrays)


def test_reach_and_infinity_survive(tmp_path):
    x = np.array([0.0, 1.0])
    for reach in (None, (0.3, None)):
        found = clmorph.sinkhorn(x, x + 0.1, 0.5, reach, backend="numpy")
        clmorph.save(found, tmp_path / "out.npz")
        assert clmorph.load(tmp_path / "out.npz").reach == reach


def test_other_endings_are_refused(solved, tmp_path):
    with pytest.raises(InputError, match=r"saved as \.npz"):
        clmorph.save(solved["plan"], tmp_path / "out.gif")
    with pytest.raises(InputError, match="without other options"):
        clmorph.save(solved["plan"], tmp_path / "out.npz", fps=3)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "text",
    [
        b"", b"[]", b"1", b"nonsense", b'{"class": "os"}', b'{"class": "Plan"}', b'{"batch": [1]}',
        b'{"batch": 3}', b'{"array": "x", "axes": 1}', b'{"class": ["Plan"]}', b"[" * 100_000,
    ],
)  # fmt: skip
def test_foreign_records_are_refused(text, tmp_path):
    path = tmp_path / "bad.npz"
    np.savez(path, result=np.frombuffer(text, np.uint8))
    with pytest.raises(InputError, match=r"bad\.npz"):
        clmorph.load(path)


RECORDS = [(b'"array_2"', b'"array_0"'), (b"[7, 9]", b"[9, 7]"), (b"Plan", b"Plam")]
ARRAYS = [(0, [6, 1, 2, 3, 4, 5, 0]), (0, range(1, 8)), (1, [0] * 7), (1, range(6)), (2, range(6))]


@pytest.mark.parametrize(
    ("name", "array", "damage"),
    [
        *(("plan", "result", texts) for texts in RECORDS),
        *(("assignment", f"array_{number}", values) for number, values in ARRAYS),
    ],
)
def test_damaged_results_are_refused(solved, name, array, damage, tmp_path):
    clmorph.save(solved[name], tmp_path / "out.npz")
    with np.load(tmp_path / "out.npz") as arrays:
        parts = dict(arrays)
    if array == "result":
        damage = bytearray(parts[array].tobytes().replace(*damage))
    parts[array] = np.array(damage, parts[array].dtype)
    np.savez(tmp_path / "bad.npz", **parts)
    with pytest.raises(InputError, match=r"bad\.npz"):
        clmorph.load(tmp_path / "bad.npz")


@pytest.mark.parametrize("name", ["assignment", "batch"])
def test_results_are_pickled(solved, name):
    assert _same(solved[name], pickle.loads(pickle.dumps(solved[name])))


def test_plain_points_have_uniform_weights(solved):
    x, y = solved["points"]
    weighted = (np.full(7, 1 / 7), x), (np.full(9, 1 / 9), y)
    found = clmorph.sinkhorn(*weighted, **solved["options"])
    np.testing.assert_array_equal(found.f, solved["potentials"].f)
    np.testing.assert_array_equal(
        clmorph.sinkhorn(x[:, 0], y[:, 0], **solved["options"]).f,
        clmorph.sinkhorn(x[:, :1], y[:, :1], **solved["options"]).f,
    )


@pytest.mark.parametrize("call", [clmorph.sinkhorn, clmorph.sinkhorn_divergence])
def test_call_of_other_libraries_is_explained(solved, call):
    x, y = solved["points"]
    a, b = np.full(7, 1 / 7), np.full(9, 1 / 9)
    for arguments in ((a, x, b, y), (a, b, x @ y.T), (a, x, b.tolist(), y)):
        for more in ({"backend": "numpy"}, {"blur": 0.05}):
            with pytest.raises(InputError, match=r"sinkhorn\(\(a, x\), \(b, y\)"):
                call(*arguments, **more)


def test_dense_plan(solved):
    plan = solved["plan"]
    dense = plan.to_scipy().toarray()
    np.testing.assert_array_equal(plan.toarray(), dense)
    np.testing.assert_array_equal(np.asarray(plan), dense)
    assert np.asarray(plan, np.float32).dtype == np.float32
    with pytest.raises(InputError, match="to_scipy"):
        plan.toarray(max_bytes=8 * 7 * 9 - 1)
