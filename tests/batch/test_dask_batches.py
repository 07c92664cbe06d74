"""Batches on a real scheduler with worker processes on loopback."""

import csv
import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from browsers import watched
from PIL import Image

import clmorph
from clmorph.batch import workers
from clmorph.batch.index import index_page
from clmorph.batch.jobs import Defaults, from_folder, read_jobs
from clmorph.batch.journal import FAR, Journal
from clmorph.batch.places import JOURNAL as NAME
from clmorph.batch.run import run_jobs
from clmorph.batch.workers import LOCAL, devices_of, local_client, quiet_dask
from clmorph.cli.main import main

pytestmark = pytest.mark.filterwarnings(
    "default::ResourceWarning", "default::DeprecationWarning",
    # Of a busy disk, on which a worker's folder is made in more than a second.
    "default:Creating scratch directories:UserWarning",
)  # fmt: skip

#: Options of all morphs: some milliseconds each; the same in Python, of commands and in TOML.
OPTIONS = {"size": 12, "frames": 3, "max_particles": 500}
IN_PYTHON = {"size": 12, "n_frames": 3, "max_particles": 500}
FLAGS = ["--size=12", "--frames=3", "--max-particles=500"]
N_PAIRS = 20


@pytest.fixture(scope="module")
def client():
    """A cluster that another program has started."""
    from distributed import Client, LocalCluster

    with (
        quiet_dask(),
        LocalCluster(
            n_workers=2, threads_per_worker=1, host=LOCAL, dashboard_address=f"{LOCAL}:0"
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Small pictures, one of them with a name of several scripts."""
    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(0)
    names = ["a", "b", "c", "d", "e f", "Bär 熊"]
    for name in names:
        pixels = rng.integers(0, 256, (4, 4, 3), np.uint8).repeat(3, 0).repeat(3, 1)
        Image.fromarray(pixels).save(folder / f"{name}.png")
    return [folder / f"{name}.png" for name in names]


@pytest.fixture
def small(tmp_path):
    """A file with the options of all morphs."""
    (tmp_path / "small.toml").write_text("size = 12\nframes = 3\nmax_particles = 500\n")
    return str(tmp_path / "small.toml")


def table(path, pictures):
    """Write a table of jobs: good pairs, the seventh with an option of its own, and bad ones."""
    pairs = [(s, t) for s in pictures for t in pictures if s != t][:N_PAIRS]
    (path.parent / "broken.png").write_bytes(b"no picture")
    (path.parent / "file").write_bytes(b"")
    bad = [
        (path.parent / "gone.png", pictures[0], "gone.gif"),
        (pictures[0], path.parent / "broken.png", "broken.gif"),
        (pictures[0], pictures[1], path.parent / "file" / "below a file.gif"),
    ]
    with path.open("w", newline="", encoding="utf-8") as stream:
        rows = csv.writer(stream)
        rows.writerow(["source", "target", "output", *OPTIONS, "reverse"])
        for number, (source, target) in enumerate(pairs):
            output = f"sub/{source.stem} {target.stem}.gif"
            rows.writerow([source, target, output, *OPTIONS.values(), "true" * (number == 6)])
        for entry in bad:
            rows.writerow([*entry, *OPTIONS.values(), ""])
    return pairs


@contextmanager
def started(*arguments):
    """Start ``clmorph batch`` in a process of its own."""
    command = [sys.executable, "-m", "clmorph", "batch", *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def records(folder):
    path = folder / NAME
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines if line.endswith("}")]


def wait_for(count, folder, process):
    end = time.monotonic() + 300
    while len(records(folder)) < count and process.poll() is None:
        assert time.monotonic() < end
        time.sleep(0.005)


@pytest.mark.full
def test_nothing_is_lost(client, pictures, tmp_path, capsys):
    """The client is killed, then a worker, then Ctrl-C; a last run does the rest."""
    pairs = table(tmp_path / "jobs.csv", pictures)
    out = tmp_path / "out"
    address = client.scheduler.address
    call = [tmp_path / "jobs.csv", "-o", out, "--backend", "numpy", "--scheduler", address]
    with started(*call) as process:
        wait_for(3, out, process)
        process.kill()
        process.communicate()
    before = {each["output"] for each in records(out) if each["status"] == "done"}
    assert 3 <= len(before) < N_PAIRS
    with started(*call) as process:
        wait_for(len(before) + 2, out, process)
        pid = next(iter(client.run(os.getpid).values()))
        os.kill(pid, signal.SIGKILL)
        wait_for(len(before) + 4, out, process)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=300)
    assert process.returncode == 130, errors
    assert f"of {N_PAIRS + 3} pairs are done: the same command does the rest" in errors
    assert "Traceback" not in errors
    assert main(["batch", *map(str, call), "--json"]) == 1
    told = capsys.readouterr()
    summary = json.loads(told.out)
    assert (summary["done"], summary["failed"]) == (N_PAIRS, 3)
    lines = {Path(each["output"]).name: each["line"] for each in summary["results"]}
    assert "gone.png: " in lines["gone.gif"]
    assert "broken.png is not an image" in lines["broken.gif"]
    assert "its folder cannot be made" in lines["below a file.gif"]
    done = [each["output"] for each in records(out) if each["status"] == "done"]
    assert len(done) == len(set(done)) == N_PAIRS  # none was done twice
    assert not list(out.rglob(".clmorph-*"))
    for number, (source, target) in list(enumerate(pairs))[::3]:
        single = tmp_path / "single.gif"
        options = [*FLAGS, "--backend", "numpy", *["--reverse"] * (number == 6)]
        assert main(["morph", str(source), str(target), "-o", str(single), *options]) == 0
        made = out / "sub" / f"{source.stem} {target.stem}.gif"
        assert made.read_bytes() == single.read_bytes(), made
    page = (out / "index.html").read_text("ascii")
    assert page.count('<tr class="done">') == N_PAIRS
    assert page.count('<tr class="failed">') == 3
    capsys.readouterr()
    # Other options must not mix with what is there.
    (tmp_path / "other.toml").write_text("blur = 0.2\n")
    other = [*map(str, call), "--config", str(tmp_path / "other.toml")]
    assert main(["batch", *other]) == 2
    assert f"{N_PAIRS} outputs were made with other options" in capsys.readouterr().err
    # An output that is gone is made again, and no other one.
    made.unlink()
    assert main(["batch", *map(str, call), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["new"] == 4
    assert made.read_bytes() == single.read_bytes()


@pytest.mark.full
def test_a_worker_out_of_memory(pictures, tmp_path, capsys):
    """A worker that takes too much is started again; its pair fails, the others are done."""
    Image.new("RGB", (9000, 9000)).save(tmp_path / "huge.png")
    jobs = [
        {"source": str(pictures[0]), "target": str(pictures[1]), "output": "a.gif", **OPTIONS},
        {"source": str(pictures[0]), "target": "huge.png", "output": "huge.gif", **OPTIONS},
        {"source": str(pictures[1]), "target": str(pictures[2]), "output": "b.gif", **OPTIONS},
    ]
    (tmp_path / "jobs.json").write_text(json.dumps(jobs))
    call = ["-o", str(tmp_path / "out"), "--backend", "numpy", "--workers", "1"]
    call += ["--memory", "600MB", "--max-pixels", "100000000", "--json"]
    assert main(["batch", str(tmp_path / "jobs.json"), *call]) == 1
    told = capsys.readouterr()
    summary = json.loads(told.out)
    assert [each["status"] for each in summary["results"]] == ["done", "failed", "done"]
    assert "out of memory" in summary["results"][1]["line"]
    assert "dashboard: http://127.0.0.1:" in told.err


def test_two_runs_do_not_share_a_folder(pictures, tmp_path, refused):
    with Journal(str(tmp_path / "out")):
        told = refused("batch", "--chain", pictures[0].parent, "-o", tmp_path / "out")
    assert "another clmorph batch writes to it" in told


def test_a_journal_is_locked_on_windows_too(tmp_path, monkeypatch):
    """By a byte behind the end, so that it can be read and written; the system refuses a second."""
    locked = []

    def locking(handle, mode, count):
        place = os.lseek(handle, 0, os.SEEK_CUR), mode, count
        if place in locked:
            raise PermissionError(13, "Permission denied")
        locked.append(place)

    fake = SimpleNamespace(locking=locking, LK_NBLCK=2)
    monkeypatch.setitem(sys.modules, "msvcrt", fake)
    monkeypatch.setattr(sys, "platform", "win32")
    record = dict.fromkeys(("output", "source", "target", "where", "key"), "x")
    with Journal(str(tmp_path)) as journal:
        journal.add(record | {"status": "done"})
        assert locked == [(FAR, 2, 1)]
        with pytest.raises(clmorph.OutputError, match="another clmorph batch writes to it"):
            Journal(str(tmp_path))
    locked.clear()
    with Journal(str(tmp_path)) as journal:
        assert journal.records == {"x": record | {"status": "done"}}


def test_links_are_followed(pictures, tmp_path, refused):
    """No output replaces a picture under another name."""
    (tmp_path / "real").mkdir()
    picture = tmp_path / "real" / "a.png"
    picture.write_bytes(pictures[0].read_bytes())
    (tmp_path / "link").symlink_to(tmp_path / "real")
    (tmp_path / "jobs.csv").write_text(f"source,target,output\nreal/a.png,{pictures[1]},a.png\n")
    call = "batch", tmp_path / "jobs.csv", "-o", tmp_path / "link", "--backend", "numpy"
    assert "a.png would replace a picture" in refused(*call)
    assert picture.read_bytes() == pictures[0].read_bytes()


def test_names_with_dashes(tmp_path):
    for name in ("a", "a-b", "b-c", "c"):
        (tmp_path / f"{name}.png").write_bytes(b"")
    jobs = from_folder(str(tmp_path), ".gif", False, Defaults(str(tmp_path / "o"), {}, None, 100))
    assert len({job.output for job in jobs}) == 6
    assert Path(jobs[0].output).name == "a-b--a.gif"


def test_a_table_in_another_folder(pictures, tmp_path):
    """Landmarks are relative to the table, as pictures are."""
    (tmp_path / "marks.csv").write_text("x, y, x', y'\n1,2,3,4\n")
    (tmp_path / "t.csv").write_text("source,target,output,landmark\na,b,c.gif,marks.csv\n")
    (job,) = read_jobs(str(tmp_path / "t.csv"), Defaults(str(tmp_path / "o"), {}, None, 100))
    assert job.options["landmarks"] == (((1.0, 2.0), (3.0, 4.0)),)


@pytest.mark.full
def test_an_index_of_earlier_runs_and_a_journal_edited_by_hand(client, pictures, tmp_path, small):
    out = tmp_path / "out"
    call = ["-o", str(out), "--backend", "numpy", "--scheduler", client.scheduler.address]
    call += ["--config", small]
    for name in ("one", "two"):
        lines = f"source,target,output\n{pictures[0]},{pictures[1]},{name}.gif\n"
        (tmp_path / f"{name}.csv").write_text(lines)
        assert main(["batch", str(tmp_path / f"{name}.csv"), *call]) == 0
    page = (out / "index.html").read_text("ascii")
    assert "one.gif" in page
    assert "two.gif" in page
    whole = records(out)
    strange = [
        {"output": str(out / "two.gif")}, {"output": str(out / "two.gif"), "status": "done"},
        whole[0] | {"iterations": 3.5, "bytes": float("inf"), "frames": float("nan")},
    ]  # fmt: skip
    with (out / NAME).open("a") as stream:
        stream.writelines(json.dumps(each) + "\n" for each in strange)
    assert main(["batch", str(tmp_path / "two.csv"), *call]) == 0
    page = (out / "index.html").read_text("ascii")
    assert page.count('<tr class="done">') == 2
    assert 'data-value="3"' in page


def test_a_client_that_is_closed(client):
    from distributed import Client

    other = Client(client.scheduler.address)
    other.close()
    measures = [([1.0], [[0.0]]), ([1.0], [[1.0]])]
    with pytest.raises(clmorph.InputError, match="closed"):
        clmorph.batch.morph([("a.png", "b.png", "c.gif")], client=other)
    with pytest.raises(clmorph.InputError, match="closed"):
        clmorph.batch.divergence_matrix(measures, 0.1, client=other)


@pytest.mark.full
def test_other_file_systems(client, pictures, tmp_path, small):
    """Pictures and outputs through fsspec; "local" stands for any of its file systems."""
    pair = f"local://{pictures[0]}", f"local://{pictures[1]}", f"local://{tmp_path}/new/out.gif"
    direct = str(pictures[0]), str(pictures[1]), str(tmp_path / "direct.gif")
    found = list(clmorph.batch.morph([pair, direct], client=client, backend="numpy", **IN_PYTHON))
    assert [each["status"] for each in found] == ["done", "done"], found
    assert (tmp_path / "new" / "out.gif").read_bytes() == (tmp_path / "direct.gif").read_bytes()
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["out.gif"]
    call = ["--chain", str(pictures[0].parent), "-o", f"local://{tmp_path}/far", "--backend"]
    call += ["numpy", "--scheduler", client.scheduler.address]
    assert main(["batch", *call, "--config", small]) == 0
    made = {path.name for path in (tmp_path / "far").iterdir()}
    assert {NAME, "index.html", "a-b.gif"} <= made
    assert len(made) == 7


@pytest.mark.full
def test_labels_and_features_of_a_table(client, pictures, tmp_path):
    """The bytes are those of `clmorph morph` with the same files, whose change is noticed."""
    rng = np.random.default_rng(2)
    for name in ("one", "other"):
        Image.fromarray(rng.integers(0, 2, (12, 12), np.uint8)).save(tmp_path / f"{name}.png")
        np.save(tmp_path / f"{name}.npy", rng.random((12, 12)))
    names = ("source", "target", "output", "source_labels", "target_labels", "source_features",
             "target_features")  # fmt: skip
    files = (*pictures[:2], "a.gif", "one.png", "other.png", "one.npy", "other.npy")
    row = dict(zip(names, map(str, files), strict=True)) | {"frames": 3, "preset": "photo"}
    (tmp_path / "jobs.json").write_text(json.dumps([row]))
    call = ["batch", str(tmp_path / "jobs.json"), "-o", str(tmp_path / "out"), "--backend", "numpy"]
    call += ["--scheduler", client.scheduler.address]
    assert main(call) == 0
    guides = ["--labels", *(str(tmp_path / f"{name}.png") for name in ("one", "other"))]
    guides += ["--features", *(str(tmp_path / f"{name}.npy") for name in ("one", "other"))]
    alone = ["-o", str(tmp_path / "b.gif"), "--frames", "3", "--backend", "numpy"]
    alone += ["--preset", "photo"]
    assert main(["morph", *map(str, pictures[:2]), *guides, *alone]) == 0
    assert (tmp_path / "out" / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()
    np.save(tmp_path / "one.npy", rng.random((12, 12)) + 5)
    os.utime(tmp_path / "one.npy", (1, 1))
    assert main(call) == 2  # another file than the one that the output was made with
    config = tmp_path / "own.toml"
    config.write_text('labels = ["one.png", "other.png"]\n')
    assert main([*call, "--redo", "--config", str(config)]) == 2


@pytest.mark.small
def test_the_bytes_are_those_of_the_device(request, device, client, pictures, tmp_path, capsys):
    paths = [str(pictures[0]), str(pictures[1])]
    index = request.node.callspec.params["device"].index
    made, single = tmp_path / "made.gif", tmp_path / "single.gif"
    pair = [(*paths, str(made))]
    (record,) = clmorph.batch.morph(pair, client=client, backend=index, **IN_PYTHON)
    assert record["status"] == "done", record
    assert record["device"] == device.description
    assert main(["morph", *paths, "-o", str(single), "--device", index, *FLAGS]) == 0
    assert made.read_bytes() == single.read_bytes()
    capsys.readouterr()


def test_divergence_matrix(client):
    rng = np.random.default_rng(1)
    measures = [(np.full(n, 1 / n), rng.random((n, 2))) for n in (5, 6, 7, 5, 6)]
    measures.append(measures[1])
    found = clmorph.batch.divergence_matrix(
        measures, 0.1, 0.3, client=client, backend="numpy", block=4
    )
    expected = clmorph.divergence_matrix(measures, 0.1, 0.3, backend="numpy")
    # Each solve ends at the same potentials, whatever is solved beside it, up to the tolerance.
    assert np.all(found >= np.maximum(0, expected.low - 1e-12))
    assert np.all(found <= expected.high + 1e-12)
    assert np.array_equal(found, found.T)
    assert np.all(np.diag(found) == 0)
    assert found[1, 5] == 0
    assert clmorph.batch.divergence_matrix([], 0.1, client=client).shape == (0, 0)
    with pytest.raises(clmorph.InputError, match="measure 1"):
        clmorph.batch.divergence_matrix([measures[0], ([1.0], [[0.0]])], 0.1, client=client)
    with pytest.warns(clmorph.ConvergenceWarning, match="did not reach"):
        clmorph.batch.divergence_matrix(
            measures[:2], 0.01, client=client, backend="numpy", max_iter=1
        )


def test_barycenters(client):
    rng = np.random.default_rng(2)
    groups = [[(np.full(n, 1 / n), rng.random((n, 2))) for n in sizes] for sizes in ((5, 6), (4,))]
    options = {"blur": 0.2, "support": 4, "seed": 3, "backend": "numpy"}
    found = clmorph.batch.barycenters(groups, client=client, **options)
    for group, got in zip(groups, found, strict=True):
        want = clmorph.barycenter(group, **options)
        assert np.array_equal(got.points, want.points)
        assert got.status == want.status
    assert clmorph.batch.barycenters([], blur=0.2, client=client) == []
    with pytest.raises(clmorph.InputError, match="group 1: measures"):
        clmorph.batch.barycenters([groups[0], []], blur=0.2, client=client, backend="numpy")
    with pytest.warns(clmorph.ConvergenceWarning, match="1 of 1 barycenters"):
        clmorph.batch.barycenters(groups[:1], client=client, **options, max_iter=1)


#: The columns that every table has, and a job in JSON but for its end.
COLUMNS = "source,target,output"
JOB = '[{"source": "a", "target": "b", "output": "c.gif"'


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.csv", "", "line 1: no column source and target and output"),
        ("a.csv", "source,target,output\n", "it holds no jobs"),
        ("a.csv", "source,target\na,b\n", "line 1: no column output"),
        ("a.csv", "source,target,output,blurr\n", "line 1: unknown option 'blurr'; did you mean"),
        ("a.csv", "source,target,output,blur,blur\n", "line 1: two columns 'blur'"),
        ("a.csv", "source,target,output,color-weight,color_weight\n", "two columns 'color_weight'"),
        ("a.csv", f"{COLUMNS},source-labels\na,b,c.gif,d\n", "line 2: expected both source_labels"),
        ("a.csv", "source,target,output\na,b,index.html\n", "a file of the batch itself"),
        ("a.csv", "source,target,output\na,b,c.gif,d\n", "line 2: more values than the 3"),
        ("a.csv", "source,target,output\na,b\n", "line 2: fewer values than the 3"),
        ("a.csv", "source,target,output\na,,c.gif\n", "line 2: no target"),
        ("a.csv", "source,target,output,blur\n\na,b,c.gif,x\n", "line 3: blur: 'x': expected"),
        ("a.csv", "source,target,output,blur\na,b,c.gif,-1\n", "line 2: "),
        ("a.csv", "source,target,output,reverse\na,b,c.gif,x\n", "line 2: reverse: 'x': expected"),
        ("a.csv", "source,target,output,preset\na,b,c.gif,x\n", "line 2: preset = 'x'"),
        ("a.csv", "source,target,output\na,b,c.xyz\n", "line 2: c.xyz: unknown ending"),
        ("a.csv", "source,target,output\na,b,c.gif\nd,e,./c.gif\n", "line 3: c.gif is the output"),
        ("a.csv", "source,target,output\na,b,c.gif\nd,out/c.gif,e.gif\n", "replace a picture"),
        ("a.csv", b"source,target,output\n\xff,b,c.gif\n", "not UTF-8"),
        ("a.csv", 'source,target,output\n"a,b,c.gif\n', "not CSV"),
        ("a.json", "[", "not JSON"),
        ("a.json", "{}", "expected a list of jobs"),
        ("a.json", "[]", "it holds no jobs"),
        ("a.json", "[3]", "entry 1: 3: expected an object"),
        ("a.json", '[{"source": 1, "target": "b", "output": "c.gif"}]', "entry 1: source = 1"),
        ("a.json", '[{"source": "a", "target": "b"}]', "entry 1: no column output"),
        ("a.json", JOB + ', "frames": 2.5}]', "frames = 2.5: expected a whole number"),
        ("a.json", JOB + ', "source_features": 3}]', "source_features = 3: expected a text"),
        ("a.csv", f"{COLUMNS},source_labels,target_labels\na,b,c.gif,d,out/c.gif\n",
         "would replace a picture"),
        ("a.txt", "", "expected a table of jobs: .csv or .json"),
    ],
)  # fmt: skip
def test_tables_that_are_wrong(tmp_path, refused, name, text, words):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert words in refused("batch", path, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "expected a table of jobs, or --all-pairs"),
        (["gone.csv"], "gone.csv: cannot be read"),
        (["a.csv", "--chain", "."], "expected a table of jobs, or"),
        (["--chain", "nowhere"], "nowhere: expected a folder"),
        (["--chain", "."], "holds 0 pictures"),
        (["--chain", "PICTURES", "--device", "none such"], "matches 'none such'"),
        (["--chain", "PICTURES", "-o", "nofs://x"], "nofs://x/clmorph-batch.jsonl: cannot be"),
        # GIF files would count as pictures when the command goes on.
        (["--chain", "PICTURES", "-o", "PICTURES"], "choose another folder of outputs"),
        (["--chain", "PICTURES", "--scheduler", "tcp://127.0.0.1:9"], "no scheduler answers"),
        (["--chain", ".", "--ending", ".xyz"], "--ending .xyz: expected one of"),
        (["--chain", ".", "--memory", "much"], "--memory much: expected a size"),
        (["--chain", ".", "--device", "a", "--backend", "numpy"], "contradict"),
        (["--chain", ".", "--scheduler", "x", "--workers", "2"], "has workers of its own"),
    ],
)
def test_arguments_that_are_wrong(tmp_path, monkeypatch, refused, pictures, arguments, words):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(workers, "TIMEOUT", 0.5)
    folder = str(pictures[0].parent)
    arguments = [folder if word == "PICTURES" else word for word in arguments]
    assert words in refused("batch", "-o", "out", *arguments)


@pytest.mark.full
def test_a_scheduler_that_dies(pictures, tmp_path):
    """The command ends with one line, and what was done counts."""
    from distributed import Client

    table(tmp_path / "jobs.csv", pictures)
    out, told = tmp_path / "out", tmp_path / "told.json"
    dask = [sys.executable, "-m", "dask"]
    scheduler = subprocess.Popen(
        [*dask, "scheduler", "--host", LOCAL, "--port", "0", "--no-dashboard",
         "--scheduler-file", str(told)],
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    processes = [scheduler]
    try:
        while not (told.exists() and told.read_text()):
            assert scheduler.poll() is None
            time.sleep(0.05)
        worker = [*dask, "worker", "--scheduler-file", str(told), "--nthreads", "1", "--no-nanny"]
        worker += ["--no-dashboard", "--death-timeout", "120", "--local-directory", str(tmp_path)]
        processes.append(subprocess.Popen(worker, stderr=subprocess.DEVNULL))
        address = json.loads(told.read_text())["address"]
        with quiet_dask(), Client(address) as client:  # without a worker the command prints a note
            client.wait_for_workers(1, timeout=300)
        call = [tmp_path / "jobs.csv", "-o", out, "--backend", "numpy", "--scheduler", address]
        with started(*call) as process:
            wait_for(2, out, process)
            scheduler.kill()
            _, errors = process.communicate(timeout=300)
        assert process.returncode == 2, errors
        assert errors.count("\n") == 2, errors
        last = errors.splitlines()[1]
        assert last.startswith("clmorph: error: the scheduler has gone")
        assert len(records(out)) >= 2
    finally:
        for process in processes:
            process.kill()
            process.wait()


def test_without_the_extra(monkeypatch, tmp_path, refused):
    monkeypatch.setattr("clmorph.batch.extra.find_spec", lambda name: None)
    told = refused("batch", "--chain", tmp_path, "-o", tmp_path)
    assert 'pip install "clmorph[dask]"' in told


def test_a_journal_with_half_a_line(tmp_path):
    rest = {"source": "s", "target": "t", "where": "line 1"}
    with Journal(str(tmp_path)) as journal:
        journal.add({"output": "a", "status": "done", "key": "1", **rest})
    path = tmp_path / NAME
    path.write_bytes(path.read_bytes() + b'{"output": "b", "sta')
    with Journal(str(tmp_path)) as journal:
        assert set(journal.records) == {"a"}
        journal.add({"output": "c", "status": "done", "key": "2", **rest})
    with Journal(str(tmp_path)) as journal:
        assert set(journal.records) == {"a", "c"}


@pytest.mark.full
def test_local_workers_take_work_from_their_command_alone(monkeypatch):
    monkeypatch.setattr(workers, "TIMEOUT", 1.0)
    with local_client(["numpy"]) as client:
        assert client.submit(os.getpid).result() != os.getpid()
        address = client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        for way in (address, address.replace("tls", "tcp")):
            with (
                pytest.raises(clmorph.InputError, match="no scheduler answers"),
                workers.remote_client(way),
            ):
                pass


def test_a_port_that_stays_silent_is_no_scheduler(monkeypatch):
    """Dask's client waits for its greeting without a limit."""
    monkeypatch.setattr(workers, "TIMEOUT", 0.5)
    with socket.create_server((LOCAL, 0)) as server:
        address = f"tcp://{LOCAL}:{server.getsockname()[1]}"
        begun = time.monotonic()
        with (
            pytest.raises(clmorph.InputError, match=r"answers \(silent for 0.5 s\)"),
            workers.remote_client(address),
        ):
            pass
        assert time.monotonic() - begun < 30


@pytest.mark.full
def test_a_client_may_follow_one_that_could_not_connect():
    """The thread of the second one may be the one that collects the first one as garbage."""
    script = """
import gc, threading
import clmorph
from clmorph.batch import workers

async def greeted(address):
    pass

workers.TIMEOUT, workers._greeted = 0.5, greeted
gc.disable()

def refused():
    try:
        with workers.remote_client("tls://127.0.0.1:1"):
            pass
    except clmorph.InputError as error:
        print(str(error)[:33])

begin = threading.Thread._set_ident

def collecting(self):
    gc.collect()
    begin(self)

refused()
threading.Thread._set_ident = collecting
refused()
"""
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.stdout == "--scheduler tls://127.0.0.1:1: no\n" * 2, done.stderr


@pytest.mark.needs_device
def test_drivers_of_one_processor_are_one_device(monkeypatch):
    from clmorph.backends.opencl.devices.find import choose_device, physical_devices

    for name in ("CLMORPH_DEVICE", "PYOPENCL_CTX"):
        monkeypatch.delenv(name, raising=False)
    found = physical_devices()
    assert found[0].index == choose_device("auto").index
    assert sum(device.kind == "CPU" for device in found) <= 1
    assert devices_of("auto", None) == [device.index for device in found]
    assert len(devices_of("auto", 3)) == 3
    monkeypatch.setenv("CLMORPH_DEVICE", "numpy")
    assert devices_of("auto", 2) == ["auto", "auto"]


@pytest.mark.full
def test_the_index_in_a_browser(browser, tmp_path):
    """A click on a heading sorts by numbers, and by falling ones at the second click."""
    given = [
        {"output": str(tmp_path / name), "status": "done", "seconds": seconds, "line": "<b>&"}
        for name, seconds in (("x.gif", 9.5), ("<i>.gif", 10.25), ("y#1.gif", 0.5))
    ]
    given.append({"output": str(tmp_path / "z.gif"), "status": "failed", "line": "why"})
    (tmp_path / "index.html").write_text(index_page(str(tmp_path), given))
    (tmp_path / "y#1.gif").write_bytes(b"GIF89a")
    with watched(browser) as (open_page, troubles):
        page = open_page((tmp_path / "index.html").as_uri(), [tmp_path.as_uri()])
        first = page.locator("tbody tr td:first-child")
        page.get_by_role("button", name="seconds").click()
        assert first.all_inner_texts() == ["y#1.gif", "x.gif", "<i>.gif", "z.gif"]
        page.get_by_role("button", name="seconds").click()
        assert first.all_inner_texts() == ["<i>.gif", "x.gif", "y#1.gif", "z.gif"]
        link = page.get_by_role("link", name="y#1.gif").evaluate("link => link.href")
        assert link == (tmp_path / "y#1.gif").as_uri()
    assert troubles == []


@pytest.mark.full
def test_ctrl_c_of_a_terminal(pictures, tmp_path):
    """The workers get it, too, and say nothing."""
    table(tmp_path / "jobs.csv", pictures)
    out = tmp_path / "out"
    call = ["batch", str(tmp_path / "jobs.csv"), "-o", str(out), "--backend", "numpy"]
    process = subprocess.Popen(
        [sys.executable, "-m", "clmorph", *call], start_new_session=True, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        wait_for(2, out, process)
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=300)
    finally:
        process.kill()
    assert process.returncode == 130, errors
    *_, last = errors.splitlines()
    assert last.startswith("clmorph: interrupted, ")
    assert "Traceback" not in errors
    assert (out / "index.html").exists()
    assert not list(out.rglob(".clmorph-*"))


class Lost:
    """A client that has lost its scheduler."""

    loop = None

    def __init__(self, lost):
        self.lost = lost

    def __getattr__(self, name):
        def call(*_, **__):
            if name == self.lost or name == "cancel":
                raise OSError("in <Heartbeat>: connection closed")
            return {"workers": {}}

        return call


@pytest.mark.in_turns
@pytest.mark.parametrize("lost", ["scheduler_info", "submit"])
def test_a_scheduler_that_cannot_be_reached(monkeypatch, lost):
    """Whatever the client raises becomes one line, also while jobs are sent."""
    monkeypatch.setattr("distributed.as_completed", lambda loop: set())
    with pytest.raises(clmorph.DeviceError, match="scheduler has gone"):
        list(run_jobs(Lost(lost), [("job", "key")], "numpy"))
