"""Each option is defined in one place, from which all other parts derive it."""

import inspect
import subprocess
import sys
import warnings
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import clmorph
from clmorph import InputError, MorphOptions, RearrangeOptions
from clmorph._shared.options import Options, specifications
from clmorph.frames.options import RenderOptions
from clmorph.measures.landmark_options import GuideOptions
from clmorph.measures.options import LiftOptions
from clmorph.output.options import FrameStyle, PlaybackOptions
from clmorph.pipeline.options import FINE_BLOCKS, BudgetOptions, preset_options
from clmorph.pipeline.presets import PRESETS
from clmorph.transport.options import PlanOptions, SolverOptions

STAGES = (
    LiftOptions, GuideOptions, SolverOptions, PlanOptions, RenderOptions, PlaybackOptions,
    FrameStyle, BudgetOptions,
)  # fmt: skip
ROOT = Path(__file__).parents[2]


def test_every_option_belongs_to_one_stage():
    names = [name for stage in STAGES for name in specifications(stage)]
    assert sorted(names) == sorted(specifications(MorphOptions))
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("stage", STAGES)
def test_stages_check_their_options(stage):
    assert isinstance(stage(), Options)
    for each in fields(stage):
        assert each.metadata["option"].help.strip()
        with pytest.raises(InputError, match=each.name if each.name != "rho" else "rho|reach"):
            MorphOptions(**{each.name: object()})
    with pytest.raises(InputError, match="unknown option 'blurr'"):
        stage(blurr=3)
    with pytest.raises(AttributeError):
        stage().blur = 3


def test_the_defaults_are_the_stages_own_but_for_reach():
    """A morph lets mass fade; the solver alone is balanced, as in other libraries."""
    for stage in STAGES:
        for each in fields(stage):
            usual = getattr(MorphOptions(), each.name)
            assert usual == (0.3 if each.name == "reach" else each.default)
    assert SolverOptions().reach is None


def test_ways_to_give_options(rng):
    pair = rng.random((2, 6, 7, 3))
    more = {"backend": "numpy", "n_frames": 3}
    whole = clmorph.morph(*pair, blur=0.08, preset="crossfade", **more)
    options = MorphOptions(preset="crossfade", blur=0.08, n_frames=3)
    for other in (
        clmorph.morph(*pair, options, backend="numpy"),
        clmorph.morph(*pair, MorphOptions(preset="crossfade"), blur=0.08, **more),
    ):
        assert other.options == whole.options
        assert np.array_equal(other.frame(0.5), whole.frame(0.5))
    with pytest.raises(InputError, match="contradict"):
        clmorph.morph(*pair, options, preset="paper")
    with pytest.raises(InputError, match="n_frames=30"):
        clmorph.morph(*pair, 30)
    with pytest.raises(InputError, match="did you mean 'splatting'"):
        clmorph.morph(*pair, splating="local")


def test_blocks_that_were_asked_for_stay_where_other_options_are_replaced():
    few = MorphOptions(detail="particles", solve_size=MorphOptions.solve_size)
    assert few.replace(n_frames=5).solve_size == MorphOptions.solve_size
    assert MorphOptions().replace(detail="particles").solve_size > MorphOptions.solve_size
    # A preset that gives way to an option of particles has its blocks for layers.
    for last in ({}, {"fps": 12.0}, {"detail": "cells"}):
        layers = {"sigma": "optimal"}, preset_options("photo"), last
        assert MorphOptions.layered(layers)["solve_size"] == FINE_BLOCKS


def test_pictures_are_reduced_by_default(rng):
    large = rng.random((40, 300, 3))
    options = {"n_frames": 2, "backend": "numpy"}
    result = clmorph.morph(large, large[:, ::-1], solve_size=16, **options)
    assert result.source.shape == (34, 256)
    assert result.solved_sizes == (16, 16)
    whole = clmorph.morph(large, large, size=None, solve_size=16, barycentric=True, **options)
    assert whole.source.shape == (40, 300)
    # The map is of the image that stays as it is.
    maps = {"weights": (np.ones((9, 64)), None)}
    clmorph.morph(clmorph.fit(large, 64), large, size=64, **maps, **options)
    for maps in ({"weights": (np.ones((40, 300)), None)}, {"color_metric": np.ones((40, 300))}):
        with pytest.raises(InputError, match="size=None"):
            clmorph.morph(large, large, backend="numpy", **maps)


@pytest.mark.parametrize(
    "function",
    [
        clmorph.barycentric_plan, clmorph.displacement_statistics, clmorph.fit, clmorph.inspect,
        clmorph.lift, clmorph.morph, clmorph.read_image, clmorph.reference.cost_matrix,
        clmorph.reference.render, clmorph.reference.sinkhorn, clmorph.reference.transport_plan,
        clmorph.sample_plan, clmorph.sinkhorn, clmorph.sinkhorn_divergence, clmorph.transport_plan,
    ],
    ids=lambda function: function.__name__,
)  # fmt: skip
def test_help_is_readable(function):
    """Signatures name `Array` or `Backend` in place of the unions that these stand for."""
    signature = str(inspect.signature(function))
    if function not in (clmorph.inspect, clmorph.morph):  # these take all options
        assert len(signature) < 900
        assert "[" not in signature.replace("tuple[", "").replace("PathLike[", "")
        assert "numpy" not in signature
    assert "numpy._typing" not in signature
    assert "{options}" not in function.__doc__
    for parameter in inspect.signature(function).parameters:
        assert parameter in function.__doc__


def test_the_types_of_keywords_are_up_to_date():
    done = subprocess.run(
        [sys.executable, ROOT / "tools" / "make_keywords.py", "--check"], check=False
    )
    assert done.returncode == 0


@pytest.mark.parametrize(("old", "name"), [("quality", "sharpness"), ("baseline", "channel_morph")])
def test_documented_modules_that_moved_still_work(old, name):
    code = (
        "import warnings; warnings.simplefilter('error');"
        f"import clmorph\ntry:\n    from clmorph.{old} import {name}\n"
        "except DeprecationWarning as warning:\n    print(warning)\n"
        f"warnings.simplefilter('ignore'); from clmorph.{old} import {name}; print({name}.__name__)"
    )
    told = subprocess.check_output([sys.executable, "-c", code], text=True).splitlines()
    assert told[0].startswith(f"clmorph.{old} has moved: import clmorph.analysis.")
    assert told[1] == name


def test_methods_that_went_warn():
    options = MorphOptions(blur=0.1)
    with pytest.warns(DeprecationWarning, match=r"use replace\(\)"):
        assert options.chosen(("blur", "tol"), {"tol": 1e-2}) == options.replace(tol=1e-2)
    with pytest.warns(DeprecationWarning, match="chosen"), pytest.raises(InputError, match="reach"):
        options.chosen(("blur", "tol"), {"reach": 1.0})
    with pytest.warns(DeprecationWarning, match="when they are made"):
        options.check_together()
    with pytest.warns(DeprecationWarning, match=r"use of\(LiftOptions\)"):
        assert RearrangeOptions(color_weight=3.0).of_lift()["color_weight"] == 3.0
    gray = np.full((3, 3, 3), 0.5)
    film = clmorph.morph(gray, gray, n_frames=2, backend="numpy")
    with pytest.warns(DeprecationWarning, match=r"Morph\.layers"):
        assert film.halfway is None


def test_presets_differ_from_the_defaults_in_what_they_list():
    for name, preset in PRESETS.items():
        assert preset.help.endswith(".")
        made = MorphOptions(preset=name).as_dict()
        usual = MorphOptions().as_dict()
        differing = {option for option in made if made[option] != usual.get(option)}
        assert differing <= set(preset.options)
    with warnings.catch_warnings(), pytest.raises(InputError, match="preset='lovely'"):
        MorphOptions(preset="lovely")
