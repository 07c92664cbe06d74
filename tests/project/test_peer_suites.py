"""Test the translations and counts of ``tools/peer_suites.py`` without any of the libraries.

Each convention is checked against a dense solve of its own problem, as the library states it.
"""

import importlib
import json
import sys
import types
from pathlib import Path

import numpy as np
import pytest

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture(autouse=True)
def tools(monkeypatch):
    if not TOOLS.exists():
        pytest.skip("the tools need a checkout")
    monkeypatch.syspath_prepend(str(TOOLS))
    monkeypatch.setenv("CLMORPH_PEER_DEVICE", "numpy")


def problem(seed=0, n=5, m=4, dimension=2):
    rng = np.random.default_rng(seed)
    x, y = rng.random((n, dimension)), rng.random((m, dimension))
    a, b = rng.uniform(0.2, 1.0, n), rng.uniform(0.2, 1.5, m)
    return np.sum((x[:, None] - y) ** 2, axis=2), a, b


def dense(cost, a, b, reg, rho, reference):
    """Iterate u = (a / K v)^tau, v = (b / K^T u)^tau with K = c exp(-C / reg)."""
    kernel = reference * np.exp(-cost / reg)
    u, v = np.ones(len(a)), np.ones(len(b))
    powers = [1.0 if np.isinf(each) else each / (each + reg) for each in rho]
    for _ in range(2000):
        u = (a / (kernel @ v)) ** powers[0]
        v = (b / (kernel.T @ u)) ** powers[1]
    return u, v, u[:, None] * kernel * v


STRENGTHS = [(0.3, (0.5, 0.5)), (0.1, (0.4, 2.0)), (0.2, (np.inf, 0.7))]


@pytest.mark.parametrize(("reg", "rho"), STRENGTHS)
@pytest.mark.parametrize("kind", ["product", "counting", "given"])
def test_reference_measures(reg, rho, kind):
    """POT's KL, POT's and OTT's entropy, and POT's `c`: potentials and plan of each."""
    from peers import bridge

    cost, a, b = problem()
    given = np.random.default_rng(3).uniform(0.5, 2.0, cost.shape)
    reference = {"product": a[:, None] * b, "counting": np.ones(cost.shape), "given": given}[kind]
    options = {"product": {}, "counting": {"counting": True}, "given": {"reference": given}}[kind]
    answer = bridge.solve_matrix(cost, a, b, reg, rho, **options)
    u, v, plan = dense(cost, a, b, reg, rho, reference)
    np.testing.assert_allclose(answer.plan, plan, rtol=1e-7)
    np.testing.assert_allclose(answer.f, reg * np.log(u), atol=1e-8)
    np.testing.assert_allclose(answer.g, reg * np.log(v), atol=1e-8)
    # The three are different problems, or this would tell nothing.
    other = bridge.solve_matrix(cost, a, b, 1.01 * reg, rho, **options)
    assert np.abs(other.plan - plan).max() > 1e-4


def test_half_the_square():
    """Points have the cost |x - y|^2 / 2: half the squared distance, at half the strengths."""
    from peers import bridge

    rng = np.random.default_rng(1)
    x, y = rng.random((6, 3)), rng.random((7, 3))
    a, b = rng.random(6), rng.random(7)
    cost = np.sum((x[:, None] - y) ** 2, axis=2)
    points = bridge.solve_points(x, y, a, b, 0.1, (0.3, 0.3))
    matrix = bridge.solve_matrix(cost, a, b, 0.2, (0.6, 0.6))
    np.testing.assert_allclose(points.plan, matrix.plan, rtol=1e-8)
    np.testing.assert_allclose(2 * points.f, matrix.f, atol=1e-9)


def test_costs_of_low_rank():
    """Any matrix of rank 11, once centered, is a cost; one of rank 12 is declined."""
    from peers import bridge

    rng = np.random.default_rng(2)
    sums = rng.random((20, 1)) + rng.random((1, 18))
    cost = rng.normal(size=(20, 11)) @ rng.normal(size=(11, 18)) + sums
    x, y, r, s = bridge.factorize(cost)
    again = 0.5 * np.sum((x[:, None] - y) ** 2, axis=2) + r[:, None] + s
    np.testing.assert_allclose(again, cost, atol=1e-11)
    assert x.shape[1] == 11
    a, b = np.full(20, 0.05), np.full(18, 1 / 18)
    before = bridge.TALLY.calls
    with pytest.raises(bridge.Declined, match="rank 11"):
        bridge.solve_matrix(rng.random((20, 18)), a, b, 0.1, (1.0, 1.0))
    assert bridge.TALLY.calls == before
    bridge.solve_matrix(rng.random((12, 18)), np.full(12, 1 / 12), b, 0.1, (1.0, 1.0))
    assert bridge.TALLY.calls == before + 1


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"epsilon": 0.0}, "entropic strength"),
        ({"rho": (0.0, 1.0)}, "marginal strength"),
        ({"rho": (np.inf, np.inf)}, "different masses"),
        ({"cost": np.full((5, 4), np.inf)}, "infinities"),
        ({"cost": np.diag(np.full(5, 1e13))[:, :4]}, "forbidden"),
        ({"reference": np.zeros((5, 4))}, "zeros"),
        ({"cost": np.full((5, 4), -30.0)}, "far more mass"),
    ],
)
def test_what_is_no_problem_of_ours(changed, reason):
    from peers import bridge

    cost, a, b = problem()
    given = {"cost": cost, "a": a, "b": b, "epsilon": 0.2, "rho": (1.0, 1.0)} | changed
    with pytest.raises(bridge.Declined, match=reason):
        bridge.solve_matrix(**given)


def test_nothing_leads_back():
    """A replaced function is replaced in every module that names it, and put back."""
    from peers import bridge

    def original():
        return "the library's own"

    def stand_in():
        return "ours"

    modules = {name: types.ModuleType(name) for name in ("peerlib", "peerlib.a", "peerlibrary")}
    for module in modules.values():
        module.solve = original
    modules["peerlib.a"].renamed = original
    sys.modules.update(modules)
    try:
        with bridge.replaced("peerlib", {original: stand_in}):
            for name in ("peerlib", "peerlib.a"):
                assert modules[name].solve() == "ours"
            assert modules["peerlib.a"].renamed() == "ours"
            assert modules["peerlibrary"].solve() == "the library's own"
        assert modules["peerlib.a"].renamed is original
    finally:
        for name in modules:
            del sys.modules[name]


def told(outcome, calls=0, message=""):
    return {"test": "t", "outcome": outcome, "calls": calls, "message": message}


@pytest.mark.parametrize(
    ("line", "outcome", "reason"),
    [
        (told("passed", 2), "passed", ""),
        (told("passed"), "not exercised", "no solver that is replaced was called"),
        (told("failed", 2, "E"), "failed", "E"),
        (told("failed"), "failed", ""),
        (told("skipped", 1, "D: not applicable: gradients"), "not applicable", "gradients"),
        (told("skipped", 0, "tf"), "not applicable", "skipped by the library: tf"),
        (told("skipped"), "failed", "skipped without a reason"),
        (told("strange", 1), "failed", "unknown outcome 'strange'"),
    ],
)  # fmt: skip
def test_classes(line, outcome, reason):
    from peers import outcomes

    assert outcomes.classify(line)[1:3] == (outcome, reason)


def test_exit_codes_and_table():
    from peers import outcomes

    good, idle, bad = (
        outcomes.classify(each) for each in (told("passed", 3), told("passed"), told("failed"))
    )
    declined = outcomes.classify(told("skipped", 0, "not applicable: low-rank plans"))
    assert outcomes.verdict([good, idle, declined]) == 0
    assert outcomes.verdict([good, bad]) == 1
    assert outcomes.verdict([idle, declined]) == 1  # nothing was tried
    assert outcomes.verdict([]) == 1
    table = outcomes.summary({"lib": [good, idle, declined, declined]}, markdown=True)
    assert "| lib | 1 | 0 | 2 | 1 | 3 |" in table
    assert "| low-rank plans | 2 |" in table


CASES = """
import pytest
from peers import bridge
def solve():
    bridge.solve_matrix([[0.0, 1.0]], [1.0], [0.5, 0.5], 0.1, (1.0, 1.0))
def test_good(): solve()
def test_idle(): pass
def test_bad():
    solve()
    assert False
def test_declined():
    solve()
    raise bridge.Declined("a reason")
def test_skipped(): pytest.skip("of its own")
@pytest.fixture
def broken(): raise ValueError
def test_setup(broken): solve()
def test_barycenter(): assert False
"""


def test_the_plugin_counts(tmp_path):
    """Each test of a small suite ends as it should, and one that fails ends the run with 1."""
    suites = importlib.import_module("peer_suites")
    outcomes = importlib.import_module("peers.outcomes")
    (tmp_path / "test_cases.py").write_text(CASES)
    found = suites.run(
        ("pot", "", ""), "numpy", tmp_path, [tmp_path / "test_cases.py"],
        tmp_path / "report.jsonl", "", False,
    )  # fmt: skip
    ended = {each.test.partition("::test_")[2]: (each.outcome, each.calls) for each in found}
    assert ended == {
        "good": ("passed", 1), "idle": ("not exercised", 0), "bad": ("failed", 1),
        "declined": ("not applicable", 1), "skipped": ("not applicable", 0),
        "setup": ("failed", 0), "barycenter": ("not applicable", 0),
    }  # fmt: skip
    assert outcomes.verdict(found) == 1
    (tmp_path / "test_cases.py").write_text("import nothing_of_this_name\n")
    found = suites.run(
        ("pot", "", ""), "numpy", tmp_path, [tmp_path / "test_cases.py"],
        tmp_path / "report.jsonl", "", False,
    )  # fmt: skip
    assert outcomes.verdict(found) == 1
    assert json.loads((tmp_path / "report.jsonl").read_text().splitlines()[0])["calls"] == 0


@pytest.mark.parametrize("arguments", [["nolibrary"], ["pot", "--tests", "pot=/nowhere"]])
def test_mistakes_in_the_command_line(arguments, monkeypatch, capsys):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    with pytest.raises(SystemExit) as ended:
        importlib.import_module("peer_suites").main(arguments)
    assert ended.value.code == 2
