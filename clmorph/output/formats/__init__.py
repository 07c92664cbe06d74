"""The formats of files: one module each, which exports its writer, endings, reader and limits."""
