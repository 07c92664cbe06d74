"""Build the distributions, inspect them, and run them from another folder."""

import email
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The sdist, and the wheel made from it, or those in a folder that CLMORPH_DIST names."""
    folder = Path(os.environ.get("CLMORPH_DIST") or tmp_path_factory.mktemp("dist")).absolute()
    if not os.environ.get("CLMORPH_DIST"):
        command = [sys.executable, "-m", "build", "--outdir", folder, ROOT]
        subprocess.run(command, check=True, capture_output=True)
    (sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    return sdist, wheel


def test_the_wheel_is_complete(built):
    """And so is the sdist, of which it is made."""
    with zipfile.ZipFile(built[1]) as wheel:
        names = set(wheel.namelist())
    kernels = {f"clmorph/cl_kernels/{path.name}" for path in (ROOT / "cl_kernels").glob("*.cl")}
    wanted = {"clmorph/output/html/viewer.html", "clmorph/py.typed", "clmorph/cli/samples/cat.png"}
    for ending in ("py", "html", "css", "js"):
        found = (ROOT / "clmorph").rglob(f"*.{ending}")
        wanted |= {path.relative_to(ROOT).as_posix() for path in found}
    assert kernels
    assert kernels | wanted <= names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert not any(name.startswith(("tests/", "tools/", "cl_kernels/")) for name in names)


def test_the_wheels_metadata(built):
    with zipfile.ZipFile(built[1]) as wheel:
        (name,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
        found = email.message_from_bytes(wheel.read(name))
    assert (found["Name"], found["Version"]) == ("clmorph", PROJECT["version"])
    assert found["Requires-Python"] == PROJECT["requires-python"]
    assert found["License-Expression"] == PROJECT["license"]
    bare = [each for each in found.get_all("Requires-Dist") if "extra ==" not in each]
    assert sorted(bare) == sorted(PROJECT["dependencies"])


def test_the_recipe_for_conda_has_the_same_requirements():
    recipe = yaml.safe_load((ROOT / ".ci/conda/recipe.yaml").read_text("utf-8"))
    needed = {each.replace(" ", "") for each in recipe["requirements"]["run"]}
    assert needed == {*PROJECT["dependencies"], f"python{PROJECT['requires-python']}"}
    assert recipe["context"]["version"] == PROJECT["version"]
    (entry,) = recipe["build"]["python"]["entry_points"]
    assert entry == f"clmorph = {PROJECT['scripts']['clmorph']}"


def test_workflows_have_every_version_of_python():
    jobs = yaml.safe_load((ROOT / ".github/workflows/test.yml").read_text("utf-8"))["jobs"]
    matrix = jobs["test"]["strategy"]["matrix"]
    tested = {*matrix["python"], *(each["python"] for each in matrix["include"])}
    words = (each.rpartition(" ")[2] for each in PROJECT["classifiers"] if "Python :: 3." in each)
    assert tested == set(words)


def test_steps_of_workflows_are_those_of_ci():
    """Beside those that install; what only a workflow runs is never tried."""
    installing = {"Install", "PoCL", "PoCL and Apple's OpenCL", "Intel's runtime"}
    ours, found = (ROOT / ".ci/run").read_text("utf-8"), set()
    for file in (ROOT / ".github/workflows").glob("*.yml"):
        for job in yaml.safe_load(file.read_text("utf-8"))["jobs"].values():
            runs = (step for step in job["steps"] if "run" in step)
            found |= {step["run"] for step in runs if step.get("name") not in installing}
    assert found
    for command in found:
        (script,) = re.findall(r"\.ci/\w+|tools/\S+\.py", command)
        assert "\n" not in command
        assert script in ours, command


@pytest.mark.parametrize(("tag", "passed"), [("v{}", True), ("v9.9", False), ("", True)])
def test_a_tag_names_the_version(built, tmp_path, tag, passed):
    """The script that builds a release, with programs that build nothing."""
    script = tmp_path / ".ci" / "distributions"
    script.parent.mkdir()
    shutil.copy(ROOT / ".ci/distributions", script)
    (tmp_path / "dist").mkdir()
    shutil.copy(built[0], tmp_path / "dist")
    given = {"GITHUB_REF_TYPE": "tag" if tag else "branch", "GITHUB_REF_NAME": tag or "main"}
    given["GITHUB_REF_NAME"] = given["GITHUB_REF_NAME"].format(PROJECT["version"])
    done = subprocess.run(
        ["bash", script, "true"], capture_output=True, text=True, check=False,
        env=os.environ | given,
    )  # fmt: skip
    assert (done.returncode == 0) == passed, done.stdout + done.stderr
    assert passed == ("is not the version" not in done.stdout)


def test_the_wheel_works_from_another_folder(built, tmp_path):
    """Installed into a folder that stands before everything else on the path."""
    site, elsewhere = tmp_path / "site", tmp_path / "elsewhere"
    elsewhere.mkdir()
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", site, built[1]],
        check=True, capture_output=True,
    )  # fmt: skip
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]);"
        "import clmorph, numpy as np; from pathlib import Path;"
        "assert Path(clmorph.__file__).is_relative_to(sys.argv[1]), clmorph.__file__;"
        "a = np.random.default_rng(0).random((2, 6, 7, 3));"
        "clmorph.morph(*a, n_frames=3).save('out.gif')"
    )
    subprocess.run([sys.executable, "-P", "-c", code, site], check=True, cwd=elsewhere)
    assert [path.name for path in elsewhere.iterdir()] == ["out.gif"]
