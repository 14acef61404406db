"""Ground for all rooms: units, settings, files, filters, the compiler."""
