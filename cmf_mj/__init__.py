"""cmf-mj: a physically faithful model of NASA Langley's Cockpit Motion Facility in MuJoCo.

The public names stand in `__init__.pyi`. Each is imported when it is first used, so that
`import cmf_mj` costs next to nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
