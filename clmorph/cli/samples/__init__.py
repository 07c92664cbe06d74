"""Sample pictures of clmorph."""
