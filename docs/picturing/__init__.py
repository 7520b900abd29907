"""How the pictures and films of the documentation are made; `docs/pictures.py` makes them."""
