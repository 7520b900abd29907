"""Messages of machines, logs of these messages, and the surface identified from logs."""
