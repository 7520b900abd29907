"""The batch on a GPU, from the same source, compiled for another machine. Experimental."""
