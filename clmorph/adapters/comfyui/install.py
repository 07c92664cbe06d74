"""The folder by which ComfyUI finds the nodes."""

from pathlib import Path

from clmorph._shared.files import atomic_path, check_file_place, errors_as_output
from clmorph._shared.printable import printable
from clmorph.errors import InputError

#: The file in the folder, and all of its text.
FILE = "__init__.py"
LINE = (
    "from clmorph.adapters.comfyui import NODE_CLASS_MAPPINGS, NODE_DISPLAY_NAME_MAPPINGS"
    "  # noqa: D104, F401\n"
)
#: Name of the folder in ``custom_nodes``.
FOLDER = "clmorph"
#: What a folder of ComfyUI holds.
PARTS = ("custom_nodes", "nodes.py", "comfy")


def install_nodes(comfyui: Path) -> Path:
    """Write the folder into ComfyUI's ``custom_nodes``; return the path of its only file."""
    lacking = [name for name in PARTS if not (comfyui / name).exists()]
    if lacking:
        raise InputError(
            f"{printable(comfyui)} is not a folder of ComfyUI (it has no {', '.join(lacking)}): "
            "expected the folder with ComfyUI's main.py"
        )
    folder = comfyui / "custom_nodes" / FOLDER
    file = folder / FILE
    others = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    ours = not others or (file.is_file() and file.read_bytes() == LINE.encode())
    if not ours or (folder.exists() and not folder.is_dir()):
        raise InputError(
            f"{printable(folder)} exists and was not written by this command: expected none; "
            "move it away"
        )
    with errors_as_output(folder):
        folder.mkdir(exist_ok=True)
    with atomic_path(check_file_place(file)) as new:
        new.write_bytes(LINE.encode())
    return file
