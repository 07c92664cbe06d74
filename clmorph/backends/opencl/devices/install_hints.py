"""Advice on how to get an OpenCL device, by operating system."""

import os
import platform
import sys
from pathlib import Path

from clmorph.backends.opencl.devices.runtimes import intel_runtime

#: The package of an OpenCL CPU runtime by Linux family (ID or ID_LIKE of /etc/os-release).
LINUX_PACKAGES = {
    "debian": "apt install pocl-opencl-icd",
    "ubuntu": "apt install pocl-opencl-icd",
    "fedora": "dnf install pocl",
    "rhel": "dnf install pocl (from EPEL)",
    "arch": "pacman -S pocl",
    "suse": "zypper install pocl",
    "alpine": "apk add pocl",
}
#: The library of NVIDIA's driver, where it may lie, and the folder of files that register drivers.
NVIDIA_LIBRARY = "libnvidia-opencl.so.1"
LIBRARY_FOLDERS = (
    "usr/lib/wsl/lib", "usr/lib/x86_64-linux-gnu", "usr/lib/aarch64-linux-gnu", "usr/lib64",
    "usr/lib", "usr/local/nvidia/lib64",
)  # fmt: skip
VENDORS = "etc/OpenCL/vendors"


def missing_files(root: Path = Path("/")) -> list[str]:
    """Return what is wrong with the files that register OpenCL drivers on Linux, in sentences."""
    vendors = os.environ.get("OCL_ICD_VENDORS")
    folder = Path(vendors) if vendors else root / VENDORS
    named = {}
    for file in sorted(folder.glob("*.icd")) if folder.is_dir() else []:
        try:
            named[file] = file.read_text("utf-8", "replace").strip()
        except OSError:
            continue
    found = [
        f"{file} names {library}, which is missing: install that driver again, or remove the file"
        for file, library in named.items()
        if Path(library).is_absolute() and not Path(library).exists()
    ]
    library = _nvidia_library(root)
    if library is not None and not any("libnvidia-opencl" in name for name in named.values()):
        file = folder / "nvidia.icd"
        found.append(
            f"NVIDIA's {library} is there, but {file} is missing: as root, mkdir -p {folder} && "
            f"echo {library} > {file}; or write this file elsewhere and name its folder in "
            "OCL_ICD_VENDORS"
        )
    return found


def _nvidia_library(root: Path) -> Path | None:
    places = (root / folder / NVIDIA_LIBRARY for folder in LIBRARY_FOLDERS)
    return next((place for place in places if place.exists()), None)


def missing_cards(root: Path = Path("/")) -> list[str]:
    """Return why WSL or a container may show no card of the machine, in sentences."""
    found, library = [], _nvidia_library(root)
    wsl = (root / "usr/lib/wsl").is_dir()
    if wsl and library is None:
        found.append(
            f"WSL: {root / LIBRARY_FOLDERS[0] / NVIDIA_LIBRARY} is missing: update NVIDIA's driver "
            "for Windows; cards of others work with Windows' own Python"
        )
    inside = any((root / name).exists() for name in (".dockerenv", "run/.containerenv"))
    if inside and not wsl and not any((root / "dev").glob("nvidia[0-9c]*")):
        if not (root / "dev/dri").is_dir():
            found.append(
                "a container without a card: NVIDIA: --gpus all -e "
                "NVIDIA_DRIVER_CAPABILITIES=compute,utility; AMD: --device /dev/kfd --device "
                "/dev/dri; Intel: --device /dev/dri"
            )
    elif inside and library is None:
        found.append(
            f"a container without {NVIDIA_LIBRARY}: start it with -e "
            "NVIDIA_DRIVER_CAPABILITIES=compute,utility"
        )
    return found


def linux_family() -> str:
    """Return the first known name in /etc/os-release, or ''."""
    try:
        lines = Path("/etc/os-release").read_text("utf-8", "replace").splitlines()
    except OSError:
        return ""
    fields = dict(line.split("=", 1) for line in lines if "=" in line)
    names = f"{fields.get('ID', '')} {fields.get('ID_LIKE', '')}".replace('"', "").split()
    return next((name for name in names if name in LINUX_PACKAGES), "")


def advice(
    system: str = sys.platform,
    machine: str = platform.machine(),
    family: str | None = None,
    installed: bool | None = None,
    missing: list[str] | None = None,
) -> list[str]:
    """Return advice on what to do where no OpenCL device works, the easiest first."""
    lines = []
    if system == "linux":
        if machine == "x86_64":
            installed = intel_runtime() is not None if installed is None else installed
            lines.append(
                "CPU: Intel's runtime is installed but was not found: unset OCL_ICD_VENDORS, if it "
                "is set, or install the runtime again"
                if installed
                else "CPU, without root: pip install 'clmorph[cpu]'"
            )
        if missing is None:
            missing = missing_files() + missing_cards()
        lines += missing
        packages = LINUX_PACKAGES.get(linux_family() if family is None else family)
        lines.append(f"CPU, as root: {packages or 'install PoCL with your package manager'}")
        lines.append(
            "GPU: your card's driver with its OpenCL part (NVIDIA: the driver itself; AMD: ROCm's "
            "OpenCL or Mesa's rusticl; Intel: intel-opencl-icd)"
        )
    elif system == "darwin":
        lines.append("macOS brings OpenCL for its GPU; pip install --upgrade pyopencl finds it")
        lines.append("CPU: PoCL, from conda-forge (conda install pocl) or Homebrew")
    elif system == "win32":
        lines.append("GPU: your card's driver brings OpenCL; update it")
        lines.append("CPU: Intel's CPU Runtime for OpenCL Applications (works on AMD too)")
    else:
        lines.append("an OpenCL driver with its ICD entry, such as PoCL's")
    lines.append("none of these: --backend numpy works everywhere, slowly")
    return lines
