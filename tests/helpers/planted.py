"""A wrong version of each kernel."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from clmorph.backends.opencl.build import program


class Fault(NamedTuple):
    """A text of a kernel, the wrong text in its place, and the operation that shows it."""

    file: str
    kernel: str
    right: str
    wrong: str
    operation: str

    def plant(self, text: str) -> str:
        """Return the text of the file with the fault."""
        begin = text.index(f"{self.kernel}(", text.index("__kernel"))
        end = text.find("__kernel", begin)
        body = text[begin : end if end > 0 else None]
        assert self.right in body, self
        return text[:begin] + body.replace(self.right, self.wrong, 1) + text[begin + len(body) :]

    @contextmanager
    def planted(self) -> Iterator[None]:
        """Let this process build the kernel with the fault."""
        right = program.source

        def source(name: str) -> str:
            return self.plant(right(name)) if name == self.file else right(name)

        program.source = source
        try:
            yield
        finally:
            program.source = right


FAULTS = [
    Fault("log_sum_exp.cl", "log_sum_exp", "step < per_share;", "step + 1 < per_share;", "softmin"),
    Fault("tile_levels.cl", "tile_levels", "fmax(level - largest", "fmax(level - 0.9 * largest",
          "softmin"),
    Fault("near_field.cl", "bound_tiles", "BOUND_TERMS + 3 * DIM];",
          "BOUND_TERMS + 3 * DIM] - 99.0f;",
          "near_pairs"),
    Fault("near_field.cl", "mark_columns", "c, limits[block])", "c, limits[block] + 40.0f)",
          "near_pairs"),
    Fault("plan_rows.cl", "count_plan_rows", "select((vint)(0), (vint)(1)",
          "select((vint)(0), (vint)(2)", "plan_rows"),
    Fault("plan_rows.cl", "fill_plan_rows", "TILE + j;", "TILE + (j ^ 1u);", "plan_rows"),
    Fault("barycentric_projection.cl", "barycentric_projection", "of_tile[1 + d] +=",
          "of_tile[1 + d] += 0.01f +", "barycentric_projection"),
    Fault("plan_shares.cl", "plan_moments", "[0] += w;", "[0] += 0.99f * w;", "plan_moments"),
    Fault("plan_shares.cl", "sample_plan_rows", "before += of_tile;", "before += 0.9f * of_tile;",
          "sample_plan_rows"),
    Fault("half_steps.cl", "prepare_rows", "n_listed, k,", "n_listed, 1.01 * k,",
          "start_iteration"),
    Fault("half_steps.cl", "row_step", "sums += PROBLEM(FIRST_ROW)", "sums += 0",
          "start_iteration of a batch"),
    Fault("half_steps.cl", "row_step", "COLUMN_SHIFTED", "COLUMN_SOFTMIN", "start_iteration"),
    Fault("half_steps.cl", "column_step", "solve_normal(", "!solve_normal(", "start_iteration"),
    Fault("sparse_half_steps.cl", "prepare_changes", "GIVEN_ORIGIN", "GIVEN_BASE",
          "start_stored_iteration"),
    Fault("sparse_half_steps.cl", "row_softmins", "m, inverse_rho_target, needed",
          "m, 1.01 * inverse_rho_target, needed", "start_stored_iteration"),
    Fault("sparse_half_steps.cl", "row_step", "COLUMN_SHIFTED", "COLUMN_SOFTMIN",
          "start_stored_iteration"),
    Fault("sparse_half_steps.cl", "column_softmins", "[NUMBER_MASS] =", "[NUMBER_MASS] = 1.01 *",
          "start_stored_iteration"),
    Fault("sparse_half_steps.cl", "column_step", "PLUS(mass, own)", "PLUS(mass, 1.01 * own)",
          "start_stored_iteration"),
    Fault("sparse_half_steps.cl", "extrapolate", "solve_normal(", "!solve_normal(",
          "start_stored_iteration"),
    Fault("sparse_half_steps.cl", "next_potential", "SPREAD(drift)", "SPREAD(9.0)",
          "start_stored_iteration"),
    Fault("sparse_half_steps.cl", "end_iteration", "MINUS(up, down)", "MINUS(up, down) + 1e10",
          "start_stored_iteration"),
    Fault("sliced_ellpack.cl", "sum_stored", "= changes[", "= 0.99f * changes[", "sum_stored"),
    Fault("sliced_ellpack.cl", "clear_stored", "= SENTINEL;", "= 0.0f;", "sum_stored"),
    Fault("particles.cl", "advect", "- 0.5f)", "- 0.499f)", "advect"),
    Fault("particles.cl", "pack_weights", "(weight, weight,", "(weight, 1.001f * weight,",
          "deposit"),
    Fault("particles.cl", "choose_width_levels", "gap = 0.5f", "gap = 0.45f", "adapt_widths"),
    Fault("particles.cl", "count_bins", "i = slice * slice_size;", "i = slice * slice_size + 1;",
          "bin_splats"),
    Fault("particles.cl", "fill_bins", "weight * sample.y", "0.999f * weight * sample.y",
          "deposit"),
    Fault("splat.cl", "splat", "ky[y] * kx;", "0.999f * ky[y] * kx;", "splat"),
    Fault("layers.cl", "edge_preserving_mean", "total += weight;", "total += 0.99f * weight;",
          "edge_preserving_mean"),
    Fault("layers.cl", "follow_paths", "(1.0f + t *", "(1.02f + t *", "follow_paths"),
    Fault("layers.cl", "place_layer", "weights[point]", "0.99f * weights[point]", "draw_layers"),
    Fault("layers.cl", "draw_layers", "way.y : way.x", "way.x : way.y", "draw_layers"),
    Fault("nearest_seeds.cl", "nearest_seeds", "number *= WAYS;", "number = WAYS * number + 1;",
          "nearest_seeds"),
    Fault("color_table.cl", "apply_table", "whole - to_least", "to_least", "apply_table"),
    Fault("grid_log_sum_exp.cl", "grid_powers", "j < m &&", "j + 1 < m &&",
          "grid_log_sum_exp"),
    Fault("grid_log_sum_exp.cl", "grid_log_sum_exp", "j - CHUNK, m,", "j, m,",
          "grid_log_sum_exp"),
    Fault("gauss_transform.cl", "sum_moments", "chunk + MOMENT_CHUNK),",
          "chunk + MOMENT_CHUNK) - 1,", "splat"),
    Fault("gauss_transform.cl", "sum_rows", "vstore4(fold", "vstore4(0.999f * fold", "splat"),
    Fault("gauss_transform.cl", "sum_columns", "+= total.x;", "+= 0.999f * total.x;", "splat"),
]  # fmt: skip
