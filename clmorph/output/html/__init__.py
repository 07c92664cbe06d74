"""One page that plays a morph without a network, as a file or in a notebook."""
