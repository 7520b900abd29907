"""The batch on a GPU: the same source, compiled for another machine. Experimental."""
