"""From a .grc file to a run: rewrite, prune, generate, run, record and replay flowgraphs."""


class FlowgraphError(RuntimeError):
    """A flowgraph that cannot be generated or run; the message is one line for the user."""
