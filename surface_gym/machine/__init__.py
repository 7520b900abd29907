"""Messages of machines, logs of these messages, and identification of a surface from logs."""
