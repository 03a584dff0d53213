"""Small faults in the source code, which `tools/mutate.py` has the tests find.

The faulty drivers of `suites/mutants.yaml` are something else: they are simulated on purpose.
"""
