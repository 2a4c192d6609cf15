"""Commands of the simulation."""

import os

# Small matrices over many points: a second thread is waited for more than it helps. Read when numpy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
