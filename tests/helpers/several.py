"""Several devices on one machine: parts of one device, and NumPy beside a device."""

import numpy as np
import pyopencl as cl

from clmorph.backends.multi_device import MultiDevice
from clmorph.backends.numpy import NumPyOperations
from clmorph.backends.opencl.backend import OpenCLOperations


def parts_of(handle):
    """Return two parts of a device, one compute unit each, or fewer where it has no more."""
    equally = cl.device_partition_property.EQUALLY
    # Mesa 22.3 ends the process where parts are asked for that it does not have.
    if equally not in handle.partition_properties:
        return []
    return handle.create_sub_devices([equally, 1])[:2]


def two_parts(handle):
    """Return operations on two parts of a device, or twice on one without, such as llvmpipe."""
    parts = parts_of(handle)
    if len(parts) < 2:
        parts = [handle, handle]
    return [OpenCLOperations(part, verify=False) for part in parts]


#: name -> function of operations on one device that returns several devices.
KINDS = {
    "halves": lambda device: MultiDevice(two_parts(device.device)),
    "with NumPy": lambda device: MultiDevice([device, NumPyOperations()]),
}


def pictures(sides=(20, 17)):
    """Return two smooth pictures."""
    made = []
    for phase, side in enumerate(sides):
        y, x = np.mgrid[:side, :side] / side
        waves = [np.sin(5 * x + k * y + phase) * np.cos(3 * y - k * phase) for k in (1, 3, 6)]
        made.append(0.5 + 0.5 * np.stack(waves, axis=-1))
    return made
