"""Ground for all rooms: units, settings, files, filters, the compiler."""

from cmf_mj.core.caches import place

place()
