"""Human driving data that simulated driving is compared with."""

from charms_bench.people.reference import Reference, packaged_references


def references() -> dict[str, Reference]:
    """The references in the package, by the names that suites use.

    Each has its origin, the terms of the recording, the number of recorded vehicles, and the counts
    of speeds and distance headways; `counts("speed")` sums them over all recorded units.
    """
    return packaged_references()
