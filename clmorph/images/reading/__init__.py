"""Image files to arrays, in bounded time and memory."""
