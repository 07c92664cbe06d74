"""Conversions between ComfyUI's tensors and images as arrays.

An IMAGE is a tensor [B, H, W, 3 or 4] of float32 in [0, 1], a MASK [B, H, W] or [H, W].
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from clmorph._shared.typing import AnyArray, Array
from clmorph.errors import InputError
from clmorph.images.pixels import to_bytes
from clmorph.images.resizing import resized
from clmorph.output.framing import Framing
from clmorph.output.options import FrameStyle


def as_images(name: str, tensor: Any, mask: Any = None) -> list[Array]:
    """Return the pictures of an IMAGE, (H, W, 3 or 4); a MASK is 1 where they are transparent.

    Values beyond [0, 1], as upscalers make them, are clipped.
    """
    pixels = _finite(name, tensor)
    if pixels.ndim != 4 or pixels.shape[3] not in (3, 4) or 0 in pixels.shape:
        raise InputError(
            f"{name} has shape {tuple(pixels.shape)}: expected an IMAGE [B, H, W, 3 or 4] that "
            "is not empty"
        )
    images = [np.clip(picture.astype(float), 0.0, 1.0) for picture in pixels]
    if mask is None:
        return images
    masks = as_masks(f"{name}_mask", mask, [image.shape[:2] for image in images])
    alphas = (image[..., 3] if image.shape[2] == 4 else 1.0 for image in images)
    return [
        np.dstack((image[..., :3], (1.0 - hidden) * alpha))
        for image, hidden, alpha in zip(images, masks, alphas, strict=True)
    ]


def as_masks(name: str, tensor: Any, shapes: Sequence[tuple[int, ...]]) -> list[Array]:
    """Return a mask (H, W) in [0, 1] for each picture; ComfyUI resizes masks, and so is done here.

    Load Image gives one of 64 x 64 zeros for a picture without opacity.
    """
    values = _finite(name, tensor)
    values = values[None] if values.ndim == 2 else values
    if values.ndim != 3 or 0 in values.shape or len(values) not in (1, len(shapes)):
        raise InputError(
            f"{name} has shape {tuple(values.shape)}: expected a MASK [B, H, W] with B = 1"
            + (f" or {len(shapes)}" if len(shapes) > 1 else "")
        )
    values = np.broadcast_to(values, (len(shapes), *values.shape[1:]))
    return [
        np.clip(resized(value[..., None].astype(float), (shape[0], shape[1]))[..., 0], 0.0, 1.0)
        for value, shape in zip(values, shapes, strict=True)
    ]


def _finite(name: str, tensor: Any) -> AnyArray:
    if not hasattr(tensor, "detach"):
        raise InputError(f"{name} is a {type(tensor).__name__}: expected a tensor")
    array: AnyArray = tensor.detach().float().cpu().numpy()
    if not np.isfinite(array).all():
        raise InputError(f"{name} holds NaN or infinity: expected values in [0, 1]")
    return array


def paired(**images: Sequence[Array]) -> list[tuple[Array, ...]]:
    """Return the first pictures of some batches together, the second ones, and so on."""
    count = max(map(len, images.values()))
    for name, batch in images.items():
        if len(batch) not in (1, count):
            sizes = ", ".join(f"{each}: {len(of)}" for each, of in images.items())
            raise InputError(
                f"{name} holds {len(batch)} pictures, expected 1 or {count} ({sizes}): take "
                "batches of one length"
            )
    return [
        tuple(batch[number if len(batch) > 1 else 0] for batch in images.values())
        for number in range(count)
    ]


def of_one_size(frames: Sequence[AnyArray], pixelated: bool = False) -> list[AnyArray]:
    """Return frames in the size of the first one; others are scaled to fit into it, with bars."""
    if len({frame.shape[:2] for frame in frames}) == 1:
        return list(frames)
    framing = Framing(FrameStyle(canvas="source"), [frame.shape for frame in frames], pixelated)
    return [np.asarray(framing(to_bytes(frame)), np.float32) / 255.0 for frame in frames]


def as_image_and_mask(frames: Sequence[AnyArray], opacity: bool) -> tuple[Any, Any]:
    """Return frames of one size as an IMAGE, and as a MASK where they are transparent.

    With `opacity` the IMAGE has four channels.
    """
    import torch

    alphas = [
        frame[..., 3] if frame.shape[2] == 4 else np.ones(frame.shape[:2]) for frame in frames
    ]
    alpha = np.stack(alphas).astype(np.float32)
    colors = np.stack([frame[..., :3] for frame in frames]).astype(np.float32)
    whole = np.concatenate((colors, alpha[..., None]), axis=3) if opacity else colors
    return torch.from_numpy(np.clip(whole, 0.0, 1.0)), torch.from_numpy(1.0 - alpha)


def has_opacity(*tensors: Any) -> bool:
    """Return whether one of some IMAGEs has a fourth channel."""
    return any(tensor is not None and tensor.shape[-1] == 4 for tensor in tensors)
