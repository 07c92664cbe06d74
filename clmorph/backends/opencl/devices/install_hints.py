"""Advice on how to get an OpenCL device, by operating system."""

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


def linux_family() -> str:
    """Return the first known name in /etc/os-release, or ''."""
    try:
        lines = Path("/etc/os-release").read_text().splitlines()
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
