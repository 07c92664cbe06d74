"""The kernel files and their kernels, which are known without pyopencl."""

#: The kernels of each file.
KERNELS = {
    "log_sum_exp.cl": ("log_sum_exp",),
    "tile_levels.cl": ("tile_levels",),
    "near_field.cl": ("bound_tiles", "mark_columns"),
    "barycentric_projection.cl": ("barycentric_projection",),
    "plan_rows.cl": ("count_plan_rows", "fill_plan_rows"),
    "plan_shares.cl": ("plan_moments", "sample_plan_rows"),
    "half_steps.cl": ("prepare_rows", "row_step", "column_step"),
    "sparse_half_steps.cl": (
        "prepare_changes", "row_softmins", "row_step", "column_softmins", "column_step",
        "extrapolate", "next_potential", "end_iteration",
    ),
    "sliced_ellpack.cl": ("clear_stored", "sum_stored"),
    "particles.cl": (
        "advect", "pack_weights", "choose_width_levels", "count_bins", "fill_bins",
    ),
    "splat.cl": ("splat",),
    "layers.cl": ("edge_preserving_mean", "follow_paths", "place_layer", "draw_layers"),
    "nearest_seeds.cl": ("nearest_seeds",),
    "color_table.cl": ("apply_table",),
    "grid_log_sum_exp.cl": ("grid_powers", "grid_log_sum_exp"),
    "gauss_transform.cl": ("sum_moments", "sum_rows", "sum_columns"),
}  # fmt: skip
