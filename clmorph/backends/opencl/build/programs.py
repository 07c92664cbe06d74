"""The programs of a device in one build, each verified before its first use."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict

import pyopencl as cl

from clmorph.backends.opencl.build import program
from clmorph.backends.opencl.build.constants import BuildConstants, choose_constants
from clmorph.backends.opencl.build.tuned_record import forget_tuning
from clmorph.backends.opencl.build.variants import KERNELS, Variant, used_together
from clmorph.backends.opencl.devices import trial, verdicts
from clmorph.backends.opencl.devices.find import index_of, mark_unusable
from clmorph.backends.records import ProgramError
from clmorph.errors import DeviceError

#: Returns what is wrong with a variant, checked in this process; '' if nothing is.
CheckHere = Callable[[Variant], str]

_ADVICE = (
    "choose another device with --device or CLMORPH_DEVICE, or the backend 'numpy', or update its "
    "driver"
)


class Programs:
    """Builds kernel files for a device and constants; each is verified before its first use."""

    def __init__(
        self,
        context: cl.Context,
        device: cl.Device,
        constants: BuildConstants,
        check_here: CheckHere | None = None,
        chosen: bool = True,
    ) -> None:
        # `check_here` checks a program where no process can be started; none is verified without.
        # With `chosen` constants a wrong program refuses the device, and not only the tuning.
        self._context, self._device, self._constants = context, device, constants
        self._check_here, self._chosen = check_here, chosen
        self._kept: dict[Variant, dict[str, cl.Kernel]] = {}

    def kernel(self, file: str, name: str, precise: bool = False) -> cl.Kernel:
        """Return a kernel of a file without rows, always the same; built at the first call."""
        variant = Variant(file, precise=precise)
        if variant not in self._kept:
            self._kept[variant] = self.kernels(variant)
        return self._kept[variant][name]

    def has(self, variant: Variant, instead: str) -> bool:
        """Return whether there is a program that the host does without; else tell so, once."""
        if variant not in self._kept:
            try:
                suited = variant.suits(self._constants)
                self._kept[variant] = self.kernels(variant) if suited else {}
            except ProgramError as error:
                error.tell(instead)
                self._kept[variant] = {}
        return bool(self._kept[variant])

    def kernels(self, variant: Variant) -> dict[str, cl.Kernel]:
        """Return new kernels of a file by name, which is built, and verified if it is new."""
        if self._check_here is not None:
            self.verify(variant)
        macros = variant.macros(self._constants)
        built = program.build(self._context, variant.file, macros, self._device)
        return {name: program.kernel(built, name) for name in KERNELS[variant.file]}

    def verify(self, variant: Variant) -> None:
        """Verify a program and those used with it, unless known; refuse a wrong or crashing one."""
        verdict = verdicts.load(self._key(variant)) or self._verdict(variant)
        reason = verdict.reason
        if not reason:
            return
        if not verdict.lasting:
            raise ProgramError(f"{self._name()} is not used for now: {reason}; {_ADVICE}")
        if self._chosen and self._constants != choose_constants(self._device):
            # The fault may be that of the tuned build alone.
            forget_tuning(self._device)
            raise DeviceError(
                f"{self._name()} fails with its tuned build: {reason}; the tuning is now "
                "forgotten: start again, and the build for this kind of device is used"
            )
        # Programs for many dimensions say nothing of those for few, which morphs use.
        if variant.is_sliced or not verdicts.condemns(reason, variant.is_optional):
            raise ProgramError(f"{self._name()} cannot run this: {reason}; {_ADVICE}")
        if self._chosen:
            mark_unusable(self._device, reason)
        raise DeviceError(f"{self._name()} is unusable: {reason}; {_ADVICE}")

    def _key(self, variant: Variant) -> str:
        return program_key(self._device, variant, self._constants)

    def _verdict(self, variant: Variant) -> verdicts.Verdict:
        """Verify a program whose verdict is unknown; its check comes first."""
        key, index = self._key(variant), index_of(self._device)
        if index is None or trial.interpreter() is None:
            assert self._check_here is not None
            return verdicts.save(key, verdicts.Verdict(self._check_here(variant)))
        others = [
            other for other in used_together(variant)
            if other != variant and other.suits(self._constants)
            and verdicts.load(self._key(other)) is None
        ]  # fmt: skip
        result = trial.run_probe(index, request=make_request(self._constants, [variant, *others]))
        if (found := verdicts.load(key)) is not None:
            return found
        # Its check ended without a verdict that another check would repeat, or with another key.
        reason = result.reason or "clmorph or the driver was perhaps updated while this process ran"
        if not result.timed_out:
            # A kill, a lack of memory: the next use checks it again.
            advice = "try again" if result.reason else "start it again"
            raise DeviceError(f"{self._name()}: {variant} was not verified: {reason}; {advice}")
        return verdicts.save(key, verdicts.Verdict(reason, lasting=False))

    def _name(self) -> str:
        return f"{' '.join(self._device.name.split())} ({self._device.platform.name.strip()})"


def program_key(device: cl.Device, variant: Variant, constants: BuildConstants) -> str:
    """Return the key of a verdict: of a program's binary, all constants and the package's code."""
    key = program.build_key(device, variant.file, variant.macros(constants))
    # Not all constants are macros: by some of them the host chooses its launches.
    of_constants = hashlib.sha256(repr(constants).encode()).hexdigest()
    return f"{verdicts.PROGRAMS}/{key}-{of_constants[:8]}-{verdicts.code_identity()[:16]}"


def make_request(constants: BuildConstants, variants: list[Variant]) -> str:
    """Return the text by which a process is asked to verify programs; see `read_request`."""
    return json.dumps([asdict(constants), [asdict(variant) for variant in variants]])


def read_request(text: str) -> tuple[BuildConstants, list[Variant]]:
    """Return build constants and variants from the text of `make_request`."""
    constants, variants = json.loads(text)
    return BuildConstants(**constants), [Variant(**variant) for variant in variants]
