"""The variants in which kernel files are built."""

from dataclasses import dataclass

from clmorph.backends.interface import MAX_EXPONENT
from clmorph.backends.numpy.layers import LEAST_LIKENESS
from clmorph.backends.opencl.build import half_step_slots, sparse_half_step_slots
from clmorph.backends.opencl.build.constants import (
    MASKED_UNROLL,
    MAX_EXPONENT_OF_PAIRS,
    MOMENT_CHUNK,
    PRECISE_UNROLL,
    SEED_LEAF,
    SEED_WAYS,
    SENTINEL,
    SLICE,
    SLICED_FROM,
    STORED_UNROLL,
    BuildConstants,
)
from clmorph.backends.opencl.build.kernel_files import KERNELS as KERNELS
from clmorph.backends.opencl.devices.verdicts import OPTIONAL
from clmorph.backends.records import WIDTH_LEVELS

Macros = dict[str, int | float]


@dataclass(frozen=True)
class Variant:
    """A kernel file, and what its macros depend on beside the build constants."""

    file: str
    #: Dimension of the points, for the files that include the row loop; 0 for others. Variants for
    #: `SLICED_FROM` serve all larger dimensions, too.
    dimension: int = 0
    precise: bool = False
    #: Whether the loop covers listed column tiles only.
    listed: bool = False
    #: Sums with a proven error bound, which need precise exponents: as exact as the exponents (1),
    #: or with powers in float32, and with exponents in float32 between chosen pairs of tiles (2).
    #: Without float64, 2 is 1.
    bounded: int = 0
    #: Whether the loop covers only the columns of listed tiles that masks choose.
    masked: bool = False

    @property
    def in_blocks(self) -> bool:
        """Whether work-items take several groups of rows: where rows suffice for all cores."""
        if self.file == "near_field.cl":
            return True
        return self.file == "log_sum_exp.cl" and (self.masked or self.is_sliced)

    @property
    def is_sliced(self) -> bool:
        """Whether the dimension is an argument of the kernels."""
        return self.dimension >= SLICED_FROM

    def stacks(self, constants: BuildConstants) -> int:
        """Return how many work-items of a group share their rows."""
        if self.file != "log_sum_exp.cl":
            return 1
        return constants.stacks(self.dimension, self.precise)

    def macros(self, constants: BuildConstants) -> Macros:
        """Return the macros of the program for these build constants."""
        if self.is_optional:
            return _half_step_macros(constants, self.file == "sparse_half_steps.cl")
        if self.dimension:
            return self._row_macros(constants)
        common = {"EXP2_BUILTIN": constants.exp2_builtin, "SENTINEL": SENTINEL}
        common["WIDTH"] = constants.width
        return common | _file_macros(constants, self.precise)[self.file]

    def _row_macros(self, constants: BuildConstants) -> Macros:
        """Return the macros of ``row_loop.cl`` and ``sums.cl``."""
        stacks, unroll = self.stacks(constants), constants.unroll
        if self.precise:
            unroll = min(unroll, PRECISE_UNROLL)
        bounded = min(int(self.bounded), constants.precise)
        made: Macros = {
            "BLOCKS": constants.blocks if self.in_blocks else 1,
            "BOUNDED": bounded,
            "MASKED": int(self.masked),
            "EXP2_BUILTIN": constants.exp2_builtin,
            "GROUP": constants.group // stacks,
            "LISTED": int(self.listed),
            "PRECISE": constants.precise if self.precise else 0,
            "SENTINEL": SENTINEL,
            "STACKS": stacks,
            "TILE": constants.tile,
            "UNROLL": unroll,
            "WIDTH": constants.width * stacks,
        }
        made |= {"SLICE": SLICE} if self.is_sliced else {"DIM": self.dimension}
        made |= {"FLOAT32_UNROLL": constants.unroll} if bounded == 2 else {}
        made |= {"MASKED_UNROLL": min(unroll, MASKED_UNROLL)} if self.masked else {}
        return made

    def suits(self, constants: BuildConstants) -> bool:
        """Return whether a device has what the file needs: float64, or long loops to iterate."""
        if self.file == "tile_levels.cl":
            return bool(constants.float64)
        if self.file == "grid_log_sum_exp.cl":
            return bool(not self.precise or constants.float64)
        return not (self.is_optional and constants.longest_loop)

    @property
    def is_optional(self) -> bool:
        """Whether the host does without the program."""
        return self.file in OPTIONAL

    def __str__(self) -> str:
        words = [f"dimension {self.dimension}"] if self.dimension else []
        words += [
            name for name in ("precise", "listed", "masked", "bounded") if getattr(self, name)
        ]
        words += ["powers in float32"] if self.bounded == 2 else []
        return f"{self.file} ({', '.join(words)})" if words else self.file


def _file_macros(constants: BuildConstants, precise: bool) -> dict[str, Macros]:
    """Return the macros of the files of no rows and no iterations; `precise` is for grids."""
    return {
        "sliced_ellpack.cl": {"SLICE": constants.slice_rows, "UNROLL": STORED_UNROLL},
        "splat.cl": {"CHUNK": constants.chunk, "TILE_GROUP": constants.tile_group},
        "grid_log_sum_exp.cl": {
            "LANES": constants.lanes if precise else constants.width, "PRECISE": 2 * precise
        },
        "tile_levels.cl": {"GROUP": constants.group},
        "layers.cl": {"LEAST_LIKENESS": LEAST_LIKENESS},
        "nearest_seeds.cl": {"GROUP": constants.group, "LEAF": SEED_LEAF, "WAYS": SEED_WAYS},
        "particles.cl": {
            "BASE_LEVEL": WIDTH_LEVELS.base, "LEVELS_PER_OCTAVE": WIDTH_LEVELS.per_octave,
            "WIDTH_LEVELS": WIDTH_LEVELS.count,
        },
        # Work-groups of the transform take scalars.
        "gauss_transform.cl": {
            "MOMENT_CHUNK": MOMENT_CHUNK, "MOMENT_GROUP": constants.group,
            "WIDTH": constants.width if constants.group == 1 else 1,
        },
        "color_table.cl": {},
    }  # fmt: skip


def _half_step_macros(constants: BuildConstants, sparse: bool) -> Macros:
    """Return the macros of ``half_steps.cl``, or of ``sparse_half_steps.cl``."""
    most = MAX_EXPONENT if constants.float64 else MAX_EXPONENT_OF_PAIRS
    made = half_step_slots.macros() | {
        "FLOAT64": constants.float64, "GROUP": constants.step_group, "LANES": constants.lanes,
        "MAX_EXPONENT": round(most), "SENTINEL": SENTINEL, "TILE": constants.tile,
        "WIDTH": constants.width,
    }  # fmt: skip
    return made | sparse_half_step_slots.macros() | {"GROUP": constants.group} if sparse else made


def usual_variants(dimension: int = 5) -> tuple[Variant, ...]:
    """Return the variants that a morph with default options uses; opaque pictures are in 5D."""
    return (
        Variant("log_sum_exp.cl", dimension),
        Variant("log_sum_exp.cl", dimension, precise=True, bounded=1),
        Variant("plan_rows.cl", dimension),
        Variant("plan_shares.cl", dimension),
        Variant("particles.cl"),
        Variant("splat.cl"),
        Variant("gauss_transform.cl"),
        Variant("layers.cl"),
    )


def further_variants(dimension: int = 5) -> tuple[Variant, ...]:
    """Return the variants that photographs and drawings use beside the usual ones."""
    return (
        Variant("tile_levels.cl"),
        Variant("near_field.cl", dimension, listed=True),
        Variant("log_sum_exp.cl", dimension, listed=True, masked=True),
        Variant("log_sum_exp.cl", dimension, precise=True),
        Variant("log_sum_exp.cl", dimension, precise=True, listed=True, bounded=2, masked=True),
        Variant("plan_shares.cl", dimension, listed=True, masked=True),
        Variant("plan_rows.cl", dimension, listed=True),
        Variant("sliced_ellpack.cl"),
        Variant("sparse_half_steps.cl"),  # last: a crash in it leaves the others verified
    )


def all_variants(dimension: int = 5) -> tuple[Variant, ...]:
    """Return every file in every variant that operations on points of a dimension use."""
    both = False, True
    softmins = [(False, False, 0), (False, True, 0), (True, False, 0), (True, True, 0)]
    softmins += [(True, False, 1), (True, True, 1)]
    masked = [(False, True, 0), (True, True, 0), (True, True, 1), (True, True, 2)]
    if dimension >= SLICED_FROM:
        masked.pop()  # all exponents of a tile are formed in one precision
    made = [Variant("log_sum_exp.cl", dimension, *kind) for kind in softmins]
    made += [Variant("log_sum_exp.cl", dimension, *kind, masked=True) for kind in masked]
    made.append(Variant("near_field.cl", dimension, listed=True))
    for file in ("plan_rows.cl", "barycentric_projection.cl", "plan_shares.cl"):
        made += [
            Variant(file, dimension, precise, listed, masked=listed and file == "plan_shares.cl")
            for precise in both
            for listed in both
        ]
    made += [Variant("grid_log_sum_exp.cl", precise=precise) for precise in both]
    rest = [Variant(file) for file in KERNELS if file not in {variant.file for variant in made}]
    return (*made, *rest)


def used_together(variant: Variant) -> tuple[Variant, ...]:
    """Return the variants that one morph, or solve, uses with this one; else this one alone."""
    if variant.is_optional:
        return (variant,)
    dimension = variant.dimension or 5
    if variant.is_sliced:
        # What a solve uses, beside what morphs use, too.
        solve = (
            Variant("log_sum_exp.cl", dimension),
            Variant("log_sum_exp.cl", dimension, precise=True, bounded=1),
        )
        return solve if variant in solve else (variant,)
    groups = usual_variants(dimension), further_variants(dimension)
    return next((group for group in groups if variant in group), (variant,))
