"""What can go wrong through no bug of ours.

    CharmsBenchError
    ├── InputError          a file, name, option or value from outside is wrong
    │   ├── SuiteError      a suite file; names file and line
    │   ├── RegistryError   a plugin is unknown, claimed twice or cannot be loaded
    │   ├── ModelError      an ONNX file is missing, broken or of the wrong shape
    │   ├── RunFolderError  a run folder cannot be read, written or continued
    │   └── DataError       recorded driving is missing, damaged or of no use
    ├── AgentError          an agent raised or answered with something unusable
    └── WorkerError         a worker process died again and again, or took too long
        └── ClusterError    a cluster cannot be reached or used, or is gone

The command line prints the message of any of these and exits with 2.
"""


class CharmsBenchError(Exception):
    """The base of every error a user can cause; its text is the whole message."""


class InputError(CharmsBenchError):
    """Something from outside is wrong: what, where, what was expected, what to do."""


class SuiteError(InputError):
    """A suite file does not say something that can be run."""


class RegistryError(InputError):
    """A plugin cannot be found or loaded."""


class ModelError(InputError):
    """A model file cannot be used."""


class RunFolderError(InputError):
    """A run folder cannot be read, written or continued."""


class DataError(InputError):
    """Recorded driving cannot be read or learnt from."""


class AgentError(CharmsBenchError):
    """An agent raised, or returned the wrong shape, type or range."""


class WorkerError(CharmsBenchError):
    """A worker process died again and again, or took too long."""


class ClusterError(WorkerError):
    """A cluster cannot be reached or used, or is gone."""
