"""A program of its own kernels that calls clmorph in its own queue, without copies of its arrays.

    python tools/host_program.py [DEVICE]

Kernels of this program draw two pictures and make two clouds of points on the device. clmorph
morphs the pictures, and solves the transport between the clouds, in this program's queue. Further
kernels work on the frames (the brightest value that each pixel has had) and on the plan (where the
points of one cloud go on average). The tool counts the commands that copy between host and device,
prints them, and ends with 1 if one of them touched an array of this program.
"""

import sys
import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
from count_transfers import COPIES, TransferCount

import clmorph
from clmorph.backends.opencl.devices.find import choose_device

#: Height and width of the pictures, and the number of points of each cloud.
HEIGHT, WIDTH, N_POINTS = 48, 64, 500
#: Length scale of the transport between the clouds, in their own unit.
BLUR = 0.05
SOURCE = r"""
// A bright disc, or a ring of another color, on a dark ground: sRGB in [0, 1].
kernel void draw(global float *picture, int ring)
{
    int x = get_global_id(0), y = get_global_id(1), width = get_global_size(0);
    float u = (x + 0.5f) / width - (ring ? 0.6f : 0.35f);
    float v = (y + 0.5f) / get_global_size(1) - 0.5f;
    float r = sqrt(u * u + v * v);
    int inside = ring ? (r > 0.15f && r < 0.3f) : (r < 0.22f);
    global float *pixel = picture + 3 * (y * width + x);
    pixel[0] = inside ? (ring ? 0.2f : 0.9f) : 0.05f;
    pixel[1] = inside ? 0.6f : 0.05f;
    pixel[2] = inside ? (ring ? 0.9f : 0.3f) : 0.15f;
}

// A spiral of points of equal masses, in columns x and y.
kernel void scatter(global float *points, global float *masses, float width, float height)
{
    int i = get_global_id(0), n = get_global_size(0);
    float r = sqrt((i + 0.5f) / n), angle = 2.3999632f * i;
    points[2 * i] = width * r * cos(angle);
    points[2 * i + 1] = height * r * sin(angle);
    masses[i] = 1.0f / n;
}

kernel void expose(global const float *frame, global float *exposure)
{
    int i = get_global_id(0);
    exposure[i] = fmax(exposure[i], frame[i]);
}

// The mean of each point's destinations, by a plan in sparse rows.
kernel void advance(
    global const long *indptr, global const int *indices, global const float *mass,
    global const float *target, global float *moved)
{
    int i = get_global_id(0);
    float total = 0.0f, x = 0.0f, y = 0.0f;
    for (long pair = indptr[i]; pair < indptr[i + 1]; ++pair) {
        total += mass[pair];
        x += mass[pair] * target[2 * indices[pair]];
        y += mass[pair] * target[2 * indices[pair] + 1];
    }
    moved[2 * i] = x / total;
    moved[2 * i + 1] = y / total;
}
"""


def built(context: cl.Context, source: str) -> cl.Program:
    """Build a program."""
    with warnings.catch_warnings():
        # pyopencl warns of Intel's compiler, which reports that all went well.
        warnings.simplefilter("ignore", cl.CompilerWarning)
        return cl.Program(context, source).build()


@dataclass
class HostProgram:
    """The program, which keeps all its arrays so that their transfers can be counted."""

    queue: cl.CommandQueue
    arrays: dict[str, cl_array.Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        program = built(self.queue.context, SOURCE)
        self._kernels = {each.function_name: each for each in program.all_kernels()}

    def _empty(self, name: str, *shape: int) -> cl_array.Array:
        self.arrays[name] = cl_array.empty(self.queue, shape, np.float32)
        return self.arrays[name]

    def _run(self, name: str, size: tuple[int, ...], *arguments: Any) -> None:
        """Enqueue a kernel, and wait for nothing."""
        values = [each.data if isinstance(each, cl_array.Array) else each for each in arguments]
        self._kernels[name](self.queue, size, None, *values)

    def morph_pictures(self, n_frames: int = 5) -> clmorph.Morph:
        """Draw two pictures, morph them, and expose one picture to all frames."""
        pictures = [self._empty(f"picture {number}", HEIGHT, WIDTH, 3) for number in (0, 1)]
        for number, picture in enumerate(pictures):
            self._run("draw", (WIDTH, HEIGHT), picture, np.int32(number))
        exposure = self._empty("exposure", HEIGHT, WIDTH, 3)
        self._run("draw", (WIDTH, HEIGHT), exposure, np.int32(0))
        morph = clmorph.morph(*pictures, n_frames=n_frames, backend=self.queue)
        for number, t in enumerate(morph.times):
            frame = self.arrays[f"frame {number}"] = morph.device_frame(t)
            self._run("expose", (frame.size,), frame, exposure)
        return morph

    def transport_clouds(self) -> clmorph.Plan:
        """Scatter two clouds, solve the transport between them, and advance the first one."""
        clouds = []
        for number, (width, height) in enumerate(((1.0, 0.3), (0.4, 0.8))):
            points = self._empty(f"points {number}", N_POINTS, 2)
            masses = self._empty(f"masses {number}", N_POINTS)
            self._run("scatter", (N_POINTS,), points, masses, np.float32(width), np.float32(height))
            clouds.append((masses, points))
        potentials = clmorph.sinkhorn(*clouds, blur=BLUR, backend=self.queue)
        plan = clmorph.transport_plan(*clouds, potentials, backend=self.queue)
        f, g = potentials.to_device(self.queue)
        indptr, indices, mass = plan.to_device(self.queue, np.float32)
        self.arrays |= {"f": f, "g": g, "indptr": indptr, "indices": indices, "mass": mass}
        moved = self._empty("moved", N_POINTS, 2)
        self._run("advance", (N_POINTS,), indptr, indices, mass, clouds[1][1], moved)
        return plan


def main(arguments: list[str]) -> int:
    if len(arguments) > 1:
        print(__doc__)
        return 2
    device = choose_device(*arguments).handle
    context = cl.Context([device])
    with TransferCount() as count:
        program = HostProgram(cl.CommandQueue(context))
        program.morph_pictures()
        program.transport_clouds()
        program.queue.finish()
    arrays = program.arrays.values()
    own, rest = count.of(arrays), count.of_others(arrays)
    print(f"{device.platform.name.strip()}, {device.name.strip()}")
    copies = ", ".join(f"{kind} {own[kind]}" for kind in COPIES)
    print(f"arrays of the program ({len(arrays)}): {copies}; mapped {own['map']} times")
    megabytes = {kind: count.n_bytes(kind) / 1e6 for kind in ("read", "write")}
    print(
        "clmorph's own state: "
        + ", ".join(f"{kind} {rest[kind]} ({megabytes[kind]:.1f} MB)" for kind in megabytes)
        + f", {', '.join(f'{kind} {rest[kind]}' for kind in COPIES[2:])}"
    )
    return int(any(own[kind] for kind in COPIES))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
