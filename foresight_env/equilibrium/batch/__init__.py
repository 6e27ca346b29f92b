"""Many games at once: threads, batch slots and games in turn."""
