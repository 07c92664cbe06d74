// Square bins of the canvas and its margin, into which particles.cl sorts and which splat.cl reads.
//
// A bin has sides of 1 / bins_per_pixel pixels, a power of two; bin (0, 0) begins `margin` bins outside
// the canvas, and particles farther out fall into the outermost ones.

// Which bin a pixel position falls into. (n_bins_x, n_bins_y) include the margins.
INLINE uint bin_of(
    const float2 position, const float bins_per_pixel, const int margin, const int2 n_bins)
{
    const int bx = (int)clamp(floor(position.x * bins_per_pixel) + margin, 0.0f, n_bins.x - 1.0f);
    const int by = (int)clamp(floor(position.y * bins_per_pixel) + margin, 0.0f, n_bins.y - 1.0f);
    return (uint)(by * n_bins.x + bx);
}
