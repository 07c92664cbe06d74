"""The composition of the stages into a morph of two images, with its options and its result."""
