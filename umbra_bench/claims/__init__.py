"""The devlog's statements, each measured.

- :mod:`statement`: what a statement, its evidence and its verdict are;
- :mod:`lab`: where they are measured;
- :mod:`steps`, :mod:`verlet`, :mod:`mass`, :mod:`frames`: the statements, by chapter of the devlog;
- :mod:`proofs`: tables and curves of what :mod:`umbra_bench.analysis` proves and maps;
- :mod:`measuring`: runs them all;
- :mod:`record`: what was measured, on disk;
- :mod:`page`, :mod:`figures`: what was measured as tables, figures and a page.
"""
