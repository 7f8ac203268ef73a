"""Sweeps: one scenario with many values of its numbers, in one process or on a cluster.

- ``plan``: the file, what it varies, and the values of any run by its number;
- ``batch``: runs of one shape as one compiled, vectorised call;
- ``work``: tasks, the parts that they write, here or on Dask;
- ``figures``: what a sweep shows.
"""
