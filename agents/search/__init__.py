"""Search of hyper-parameters: trials in generations, pruned on the way, with a report."""
