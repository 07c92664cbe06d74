"""Parts of the solver behind `clmorph.sinkhorn`."""
