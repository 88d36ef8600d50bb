"""Linear algebra runs in one thread: the matrices are small, and on a busy machine OpenBLAS's threads wait for each
other in loops, which took ten times the work. OpenBLAS looks when NumPy is loaded, here and in what is started, so this
stands before every import of the tests.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
