"""Checks every shape annotation of the packages while tests run; in production they cost nothing."""

import signal

import torch
from hypothesis import settings
from jaxtyping import install_import_hook

torch.set_num_threads(1)
# Started in the background of a script, this process and its children ignore interruptions, which tests send.
signal.signal(signal.SIGINT, signal.default_int_handler)
settings.register_profile("repro", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("repro")
# Not as a context: modules are imported as tests need them, and each must be caught.
install_import_hook(["repro", "repro_live", "repro_companion"], "beartype.beartype")
