"""Checks every shape annotation of the package while tests run; in production they cost nothing."""

import torch
from hypothesis import settings
from jaxtyping import install_import_hook

torch.set_num_threads(1)
settings.register_profile("repro", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("repro")
# Not as a context: modules are imported as tests need them, and each must be caught.
install_import_hook("repro", "beartype.beartype")
