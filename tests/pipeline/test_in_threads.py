"""Morphs in threads have the bytes of morphs in a row, and leave nothing."""

import gc
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest
from benching import CountedBuffer

import clmorph
from clmorph.pipeline.presets import PRESETS

#: Sets of options: other forms of the plan, and other ways to draw.
FORMS = [
    {"sample": 3, "seed": 2}, {"barycentric": True}, {"splatting": "local", "detail": "particles"},
    {"reach": None, "color_space": "lab", "endpoints": "paper"}, {"unmatched": "grow"},
]  # fmt: skip
ALL_PRESETS = pytest.param([{"preset": name} for name in PRESETS], marks=pytest.mark.full)


def held(device):
    """What this process holds: threads, open files, temporary files, and objects of OpenCL."""
    gc.collect()
    pool, files = device.work._pool, Path("/proc/self/fd")
    return np.array([
        threading.active_count(), len(list(files.iterdir())) if files.exists() else 0,
        len(list(Path(tempfile.gettempdir()).iterdir())), pool.active_bytes, CountedBuffer.now,
        # Programs, kernels and queues, too, where the driver counts them (PoCL does), without what
        # is kept for the next buffers.
        device.context.reference_count - pool.held_blocks,
    ])  # fmt: skip


@pytest.mark.filterwarnings("ignore")  # some sets do not converge
@pytest.mark.parametrize("sets", [FORMS, ALL_PRESETS], ids=["forms", "presets"])
def test_morphs_in_threads_are_those_in_a_row(each_device, sets, rng, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(cl, "Buffer", CountedBuffer)
    images = rng.random((9, 12, 3)), rng.random((11, 8, 4))

    def made(options):
        result = clmorph.morph(*images, n_frames=3, backend=each_device, **options)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "out.gif"
            result.save(file, canvas="source")
            return [frame.tobytes() for frame in result.iter_frames()], file.read_bytes()

    wanted = [made(options) for options in sets]
    for _ in range(2):
        before = held(each_device)
        with ThreadPoolExecutor(4) as threads:
            assert list(threads.map(made, sets)) == wanted
    assert np.all(held(each_device) <= before)
