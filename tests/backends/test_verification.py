"""Programs are verified before their first use; wrong ones are found, and verdicts are kept."""

import json
import re
import sys
from dataclasses import asdict, replace
from importlib import resources
from pathlib import Path

import numpy as np
import planted
import pyopencl as cl
import pytest
from conftest import TESTED
from planted import FAULTS, Fault
from several import parts_of

from clmorph import DeviceError, morph
from clmorph.backends.opencl import probe
from clmorph.backends.opencl.backend import OpenCLOperations
from clmorph.backends.opencl.build import programs
from clmorph.backends.opencl.build.constants import apply_quirks, choose_constants, gpu_constants
from clmorph.backends.opencl.build.programs import Programs, program_key, read_request
from clmorph.backends.opencl.build.variants import (
    KERNELS,
    Variant,
    all_variants,
    further_variants,
    usual_variants,
)
from clmorph.backends.opencl.devices import cache as storage
from clmorph.backends.opencl.devices import find as devices
from clmorph.backends.opencl.devices import trial, verdicts
from clmorph.backends.opencl.devices.quirks import QUIRKS, find_quirks
from clmorph.backends.opencl.devices.trial import BEGUN, ENDED, LOADED, Ended
from clmorph.backends.opencl.devices.verdicts import OPTIONAL, WRONG, Verdict
from clmorph.backends.opencl.verification.table import first_failure
from clmorph.backends.records import ProgramError

PLAIN = Variant("log_sum_exp.cl", 5)
OTHER = Variant("plan_rows.cl", 3, precise=True)
VARIANTS = all_variants()
WORKS = Verdict(pairs_per_second=1.0)

pytestmark = pytest.mark.needs_device


@pytest.fixture
def empty(empty_cache, fresh_search):
    """An empty cache, and no knowledge in this process."""
    return empty_cache


# --- planted faults -----------------------------------------------------------------------


def test_every_kernel_has_a_fault_and_every_file_a_variant():
    found = set()
    for entry in resources.files("clmorph.cl_kernels").iterdir():
        if entry.name.endswith(".cl"):
            kernels = re.findall(r"__kernel[^;{]*?void (\w+)\(", entry.read_text())
            found |= {(entry.name, kernel) for kernel in kernels}
    assert {(fault.file, fault.kernel) for fault in FAULTS} == found
    assert {(file, kernel) for file, of in KERNELS.items() for kernel in of} == found
    assert {variant.file for variant in VARIANTS} == set(KERNELS)
    assert set(usual_variants() + further_variants()) <= set(VARIANTS)


def failure_of(fault, variant):
    with fault.planted():
        return first_failure(OpenCLOperations(TESTED[0].handle, verify=False), variant)


#: By default the last kernel of each file.
LAST = {fault.file: fault for fault in FAULTS}.values()


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(fault, id=fault.kernel, marks=[] if fault in LAST else [pytest.mark.full])
        for fault in FAULTS
    ],
)
def test_a_planted_fault_is_found(empty, fault):
    """In each kernel in turn; the reason names the file and an operation that uses the kernel."""
    reason = failure_of(fault, next(each for each in VARIANTS if each.file == fault.file))
    assert reason.startswith(f"{WRONG}{fault.file}"), reason
    assert fault.operation in reason
    assert "tolerance" in reason or "IndexError" in reason


@pytest.mark.full
@pytest.mark.parametrize("built", [v for v in all_variants(3) if v.dimension], ids=str)
def test_faults_are_found_in_every_variant(empty, built):
    for fault in FAULTS:
        assert fault.file != built.file or failure_of(fault, built), fault


@pytest.mark.parametrize(("precise", "bounded"), [(False, 0), (True, 0), (True, 1), (True, 2)])
def test_results_that_are_no_numbers_are_found(empty, precise, bounded):
    """NaN is neither above nor below a tolerance; sums over near pairs must not pass with it."""
    fault = Fault("log_sum_exp.cl", "log_sum_exp", "VSTORE(m,", "VSTORE(m * NAN,", "softmin")
    variant = Variant("log_sum_exp.cl", 5, precise, True, bounded, masked=True)
    assert "softmin" in failure_of(fault, variant)


@pytest.mark.full
@pytest.mark.parametrize("fault", [FAULTS[0], FAULTS[-1]], ids=lambda fault: fault.kernel)
def test_the_probe_refuses_a_device_with_a_wrong_kernel(empty, monkeypatch, fault):
    """A new process tries it, says why it is refused, and remembers."""
    script, index = empty / "probe.py", TESTED[0].index
    script.write_text(
        f"import sys; sys.path.append({str(Path(planted.__file__).parent)!r})\n"
        "import planted\n"
        "from clmorph.backends.opencl import probe\n"
        f"with planted.FAULTS[{FAULTS.index(fault)}].planted(): probe.main(*sys.argv[1:])\n"
    )
    monkeypatch.setattr(
        trial, "_command", lambda python, *more: [python, script, *filter(None, more)]
    )
    device = devices.tried(index)
    assert device.reason.startswith(f"{WRONG}{fault.file}"), device.reason
    assert fault.operation in device.reason
    assert (device.usable, device.computes_wrongly) == (False, True)
    monkeypatch.setattr(devices, "run_probe", None)  # nothing is tried again
    devices.tried.cache_clear()
    with pytest.raises(DeviceError, match=re.escape(device.reason)):
        devices.choose_device(index)


# --- quirks -----------------------------------------------------------------------------------


#: Programs that few tests use otherwise are compared on every device.
ON_ALL = "grid_log_sum_exp.cl", "color_table.cl"


@pytest.mark.in_turns
@pytest.mark.parametrize(
    "built",
    [pytest.param(v, marks=pytest.mark.small) if v.file in ON_ALL else v for v in VARIANTS],
    ids=str,
)
def test_every_variant_is_right(variant, built):
    if not built.suits(variant.constants):
        pytest.skip("there the host iterates")
    assert first_failure(variant, built) == ""


def check_with(quirk, plain, device, built):
    """Verify a variant where a quirk changes its program or its launches."""
    own = find_quirks(device.device)
    without, constants = (apply_quirks(plain, quirks) for quirks in (own - {quirk}, own | {quirk}))
    if not built.suits(constants):
        pytest.skip("there the host iterates")
    if constants.longest_loop == without.longest_loop and (
        built.macros(constants) == built.macros(without)
    ):
        pytest.skip("the quirk changes nothing of this program")
    forced = OpenCLOperations(device.device, constants, verify=False)
    assert first_failure(forced, built) == ""


@pytest.mark.parametrize("quirk", QUIRKS)
@pytest.mark.parametrize("built", VARIANTS, ids=str)
def test_every_variant_is_right_with_each_quirk(device, quirk, built):
    check_with(quirk, choose_constants(device.device, frozenset()), device, built)


@pytest.mark.full
@pytest.mark.parametrize(
    "quirk", ["small_groups", "small_local_memory", "inexact_exp2", "short_loops"]
)
@pytest.mark.parametrize("built", {each.file: each for each in VARIANTS}.values(), ids=str)
def test_every_file_is_right_with_each_quirk_of_a_card(device, quirk, built):
    """In its last variant, in the build of a graphics card."""
    check_with(quirk, gpu_constants(256), device, built)


# --- verdicts on programs -------------------------------------------------------------------


@pytest.fixture
def requests(monkeypatch, empty):
    """The variants that processes were asked to verify; they find nothing wrong."""
    asked = []

    def run_probe(index, request=None):
        constants, variants = read_request(request)
        asked.append(variants)
        for variant in variants:
            key = program_key(TESTED[0].handle, variant, constants)
            verdicts.save(key, Verdict())
        return WORKS

    monkeypatch.setattr(trial, "run_probe", run_probe)
    return asked


@pytest.fixture
def one():
    """Operations on the first tested device."""
    return OpenCLOperations(TESTED[0].handle)


def made(device, chosen=True, **changes):
    return Programs(
        device.context, device.device, replace(device.constants, **changes),
        lambda variant: "checked here", chosen,
    )  # fmt: skip


def key_of(device, variant=OTHER):
    return program_key(device.device, variant, device.constants)


def of_device(device):
    return verdicts.load(verdicts.verdict_key(device.device))


def refused(device, words, variant=OTHER, **options):
    """Return why a program cannot be used, which is told in one line."""
    with pytest.raises(DeviceError, match=words) as caught:
        made(device, **options).verify(variant)
    assert "\n" not in str(caught.value)
    return caught.value


def checking(monkeypatch, folder, lines, body=""):
    """Let a script stand for the process of a check: it prints lines, and then runs a body."""
    script = folder / "check.py"
    script.write_text(
        f"import os, signal, sys, time\nprint(*{tuple(lines)!r}, sep='\\n', flush=True)\n{body}"
    )
    monkeypatch.setattr(trial, "_command", lambda python, *more: [python, script, str(more[1])])


def test_a_program_is_verified_once(one, requests, empty):
    made(one).verify(PLAIN)
    assert len(requests) == 1
    # Those that most morphs use come together, and the wanted one first.
    assert requests[0][0] == PLAIN
    assert set(requests[0]) == set(usual_variants())
    made(one).verify(OTHER)
    assert requests[1:] == [[OTHER]]
    for _ in range(2):
        for variant in (*usual_variants(), OTHER):
            made(one).verify(variant)
        verdicts._known.clear()  # as in a new process
    assert len(requests) == 2
    assert len(list((empty / "verified").iterdir())) == len(usual_variants()) + 1


def test_without_a_cache_folder_the_process_remembers(one, requests, monkeypatch):
    monkeypatch.setattr(storage, "cache_folder", lambda: None)
    for _ in range(2):
        made(one).verify(OTHER)
    assert requests == [[OTHER]]


@pytest.mark.parametrize("change", ["code", "launches", "trying again"])
def test_another_verdict_is_needed(one, requests, monkeypatch, change):
    """The length of launches is no macro, so that the binary is the same."""
    made(one).verify(OTHER)
    if change == "code":
        monkeypatch.setattr(verdicts, "code_identity", lambda: "0123456789abcdef")
    if change == "trying again":
        devices.forget_verdicts()
    made(one, **{"longest_loop": 7000} if change == "launches" else {}).verify(OTHER)
    assert requests == [[OTHER], [OTHER]]


def test_a_wrong_program_makes_the_device_unusable(one, empty, monkeypatch):
    device = TESTED[0]
    reason = f"{WRONG}{OTHER}: softmin is off by 1 nats (tolerance 0.1)"
    verdicts.save(key_of(one), Verdict(reason))
    # Constants that somebody tries say nothing of those that are chosen.
    refused(one, "softmin is off", chosen=False)
    assert of_device(one) is None
    before = verdicts.refusals()
    told = str(refused(one, "softmin is off"))
    assert all(words in told for words in (device.name, "choose another device", "--device"))
    assert verdicts.refusals() == before + 1
    monkeypatch.setattr(devices, "run_probe", None)  # nothing is tried again
    for _ in range(2):
        assert not devices.tried(device.index).usable
        with pytest.raises(DeviceError, match="softmin is off"):
            devices.choose_device(device.index)
        assert devices.choose_device(device.index, even_wrong=True).computes_wrongly
        verdicts._known.clear()  # as in a new process
        devices.tried.cache_clear()


@pytest.mark.parametrize("built", [OTHER, Variant(OPTIONAL[0])], ids=str)
@pytest.mark.parametrize(
    ("body", "words", "lasting"),
    [("os.abort()", "crashed", True), ("time.sleep(60)", "within 5 s", False),
     ("sys.exit('no card')", r"status 1\) on .*: no card", True)],
)  # fmt: skip
def test_a_crash_or_a_hang_in_a_check_is_told(one, empty, monkeypatch, body, words, lasting, built):
    """In an optional program it costs that program alone."""
    checking(monkeypatch, empty, [LOADED, f"{BEGUN} {key_of(one, built)} {built}"], body)
    # On a busy machine Python may take seconds to start.
    monkeypatch.setenv("CLMORPH_PROBE_SECONDS", "5" if "sleep" in body else "60")
    counts = lasting and not built.is_optional
    for _ in range(2):
        told = refused(one, words, built)
        assert isinstance(told, ProgramError) is not counts
        assert built.file in str(told)
        monkeypatch.setattr(trial, "_run", None)  # this process asks no second time
    assert (empty / "verified").exists() == lasting
    verdicts._known.clear()
    assert bool(verdicts.load(key_of(one, built))) == lasting
    # A check that ends without evidence refuses the program alone, and for this process alone.
    assert (of_device(one) is not None) == counts
    assert not counts or of_device(one).reason


@pytest.mark.parametrize("status", [-6, None, 3])
def test_a_trial_that_ends_in_an_optional_program_counts(empty, status):
    """Its check comes after the verdict."""
    lines = [LOADED, f"{trial.VERDICT} {json.dumps(asdict(WORKS))}"]
    assert trial._judge(Ended(status, lines), 60.0).reason
    lines.append(f"{BEGUN} key {OPTIONAL[0]}")
    assert trial._judge(Ended(status, lines), 60.0) == WORKS
    assert OPTIONAL[0] in verdicts.load("key").reason


@pytest.mark.parametrize("reason", ["", "refused", f"{WRONG}x"])
def test_a_trial_with_a_refused_optional_program(one, empty, monkeypatch, capsys, reason):
    """It is no reason against the device, and a wrong one is."""
    iterations = Variant(OPTIONAL[0])
    if not iterations.suits(one.constants):
        pytest.skip("there the host iterates")
    monkeypatch.setattr(
        probe, "first_failure", lambda _, variant: reason if variant == iterations else ""
    )
    monkeypatch.setattr(probe, "throughput", lambda *_, **__: 1.0)
    probe.main(TESTED[0].index)
    verdict = trial._judge(Ended(0, capsys.readouterr().out.splitlines()), 60.0)
    assert verdict.reason == reason * (WRONG in reason)
    key = program_key(one.device, iterations, choose_constants(one.device))
    assert verdicts.load(key).reason == reason


@pytest.mark.parametrize("reason", [f"{WRONG}x", "its driver crashed on x", "refused"])
def test_of_the_further_programs_a_wrong_one_counts_in_a_trial(empty, monkeypatch, reason):
    monkeypatch.setattr(
        devices, "run_probe", lambda _, request=None: Verdict(reason) if request else WORKS
    )
    device = devices.tried(TESTED[0].index)
    assert (device.usable, device.reason) == ((False, reason) if WRONG in reason else (True, ""))
    assert not {Variant(file) for file in OPTIONAL} & set(usual_variants())


@pytest.mark.parametrize("busy", [False, True])
def test_resources_that_are_in_use_are_told_from_a_fault(one, monkeypatch, busy):
    """NVIDIA's driver says OUT_OF_RESOURCES of an illegal access, and a new context then works."""

    def fail(*_):
        raise cl.RuntimeError(
            cl._cl._ErrorRecord(msg="", code=cl.status_code.OUT_OF_RESOURCES, routine="finish")
        )

    monkeypatch.setattr(probe, "first_failure", fail)
    if busy:
        monkeypatch.setattr(cl, "Context", fail)
    verdict = probe._check(one, PLAIN)
    assert "OUT_OF_RESOURCES" in verdict.reason
    assert verdict.lasting is not busy


def test_an_update_while_a_process_runs_is_told(one, empty, monkeypatch):
    """The check of a program then has another key than the process that asks for it."""
    with monkeypatch.context() as patch:
        fine = f"{trial.VERDICT} {json.dumps(asdict(WORKS))}"
        checking(patch, empty, [LOADED, f"{BEGUN} verified/new {OTHER}", f'{ENDED} ""', fine])
        refused(one, "was perhaps updated while this process ran; start it")
    assert verdicts.load(key_of(one)) is None


@pytest.mark.skipif(sys.platform == "win32", reason="kills as POSIX does")
@pytest.mark.parametrize("signal", ["SIGINT", "SIGKILL"])
def test_a_kill_of_a_check_is_forgotten(one, empty, monkeypatch, signal):
    """Ctrl-C reaches a check that a thread has started, too."""
    default = "signal.signal(signal.SIGINT, signal.SIG_DFL)"
    with monkeypatch.context() as patch:
        checking(
            patch, empty, [LOADED, f"{BEGUN} {key_of(one)} {OTHER}"],
            f"{default}; os.kill(os.getpid(), signal.{signal})",
        )  # fmt: skip
        refused(one, "was killed .*; try again")
    assert verdicts.load(key_of(one)) is None
    assert of_device(one) is None
    # On a busy machine a real check may take longer than the limit for users.
    monkeypatch.setenv("CLMORPH_PROBE_SECONDS", "300")
    made(one).verify(OTHER)


@pytest.mark.parametrize(
    ("status", "lines", "words", "lasting"),
    [
        (0xC000013A, [LOADED], "was killed (status 0xc000013a)", False),  # Ctrl-C on Windows
        (-11, [], "its driver crashed (signal 11) on a kernel", True),
        (1, [LOADED, f"{BEGUN} k x.cl"], "its driver crashed (status 1) on x.cl: why", True),
        (1, [], "its probe ended with status 1: why", False),
        (0, ["noise"], "its probe ended with status 0: why", False),
        (None, [], "did not build and verify the kernels within 60 s", False),
        (None, [], "tried again by the next process, and CLMORPH_PROBE_SECONDS sets", False),
    ],
)
def test_how_a_probe_ends_is_told(empty, status, lines, words, lasting):
    verdict = trial._judge(Ended(status, lines, ["", "why", " "]), 60.0)
    assert verdict.lasting == lasting
    assert words in verdict.reason


def test_a_refused_build_is_of_one_program_only(one, empty, monkeypatch):
    """A compiler that refuses points of another dimension does not make other morphs impossible."""
    reason = f"{OTHER}: a device cannot build {OTHER.file}: 71:2: error: too long"
    lines = [
        LOADED, f"{BEGUN} {key_of(one)} {OTHER}", f"{ENDED} {json.dumps(reason)}",
        f"{trial.VERDICT} {json.dumps(asdict(Verdict(reason)))}",
    ]  # fmt: skip
    with monkeypatch.context() as patch:
        checking(patch, empty, lines)
        for _ in range(2):
            refused(one, "cannot run this: .*dimension 3")
            verdicts._known.clear()
    assert verdicts.load(key_of(one)).reason == reason
    assert of_device(one) is None
    made(one).verify(Variant("log_sum_exp.cl", 4, precise=True))


def test_programs_before_a_crash_keep_their_verdicts(one, empty, monkeypatch):
    lines = [
        LOADED, f"{BEGUN} {key_of(one, PLAIN)} {PLAIN}", ENDED + ' ""',
        f"{BEGUN} {key_of(one)} {OTHER}",
    ]  # fmt: skip
    checking(monkeypatch, empty, lines, "os.abort()")
    made(one).verify(PLAIN)
    refused(one, r"crashed .* plan_rows.cl \(dimension 3, precise\)")


@pytest.mark.parametrize("reason", ["", f"{WRONG}x: größer \u2028 als 1"])
def test_text_that_a_driver_prints_hides_nothing(one, empty, monkeypatch, reason):
    """Not even without an end of its line, and where the locale has ASCII only."""
    checking(
        monkeypatch, empty, [],
        "import atexit\n"
        "sys.stdout.reconfigure(encoding='ascii')\n"
        "from clmorph.backends.opencl import probe\n"
        "os.write(1, b'driver 1.0')\n"
        "atexit.register(lambda: os.write(1, b'driver out'))\n"
        "def failure(*_):\n"
        "    os.write(1, b'building...')\n"
        f"    return {reason!r}\n"
        "probe.first_failure = failure\n"
        f"probe.main({TESTED[0].index!r}, sys.argv[1])\n",
    )  # fmt: skip
    request = programs.make_request(one.constants, [OTHER])
    verdict = trial.run_probe(TESTED[0].index, request)
    assert verdict.reason == reason
    assert verdicts.load(key_of(one)).reason == reason


@pytest.mark.parametrize(
    ("module", "name"), [(trial, "interpreter"), (programs, "index_of")], ids=str
)
def test_where_no_process_can_be_started_programs_are_checked_here(
    one, requests, monkeypatch, module, name
):
    """Without an interpreter, or for a device that OpenCL's loader does not list."""
    monkeypatch.setattr(module, name, lambda *_: None)
    refused(one, "checked here", chosen=False)
    assert requests == []


def test_no_process_that_verifies_starts_another(one, empty, monkeypatch):
    monkeypatch.setattr(trial, "run_probe", None)
    assert first_failure(OpenCLOperations(one.device, verify=False), OTHER) == ""


def test_a_part_of_a_device_is_verified_on_the_whole(one, requests):
    part = (parts_of(one.device) or pytest.skip("the device has no parts"))[0]
    assert devices.index_of(part) == TESTED[0].index
    made(one).verify(OTHER)
    Programs(cl.Context([part]), part, one.constants, lambda variant: "checked here").verify(OTHER)
    assert requests == [[OTHER]]


def test_a_program_is_verified_in_a_real_process(one, empty):
    """Its binary then lies in the cache, and is the one that is used."""
    kernels = made(one).kernels(Variant("plan_rows.cl", 4, precise=True))
    assert set(kernels) == set(KERNELS["plan_rows.cl"])
    assert len(list((empty / "verified").iterdir())) == 1


def test_programs_of_a_morph_are_verified_together(one, requests):
    y, x = np.mgrid[:40, :40] / 40
    pictures = np.stack([x, y, x * y], axis=-1), np.stack([y, 1 - x, np.cos(x * y)], axis=-1)
    morph(*pictures, n_frames=2, backend=OpenCLOperations(one.device))
    together = [set(request) for request in requests if not request[0].is_optional]
    assert together == [set(usual_variants())]
    assert len(requests) <= 2


def test_further_programs_are_verified_together(one, requests):
    wanted = {variant for variant in further_variants() if variant.suits(one.constants)}
    for variant in sorted(wanted, key=lambda variant: variant.is_optional):
        made(one).verify(variant)
    assert [set(request) for request in requests] == [wanted]


def test_forced_quirks_have_a_verdict_of_their_own(monkeypatch):
    handle = TESTED[0].handle
    plain = verdicts.verdict_key(handle)
    monkeypatch.setenv("CLMORPH_QUIRKS", "small_groups")
    assert verdicts.verdict_key(handle) != plain
    assert plain == f"devices/{verdicts.device_key(handle)}"
