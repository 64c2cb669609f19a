"""The runs of a comparison and the batches of its references on the workers of a Dask cluster."""
