"""Settings shared by the environments' tests."""

import os

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
