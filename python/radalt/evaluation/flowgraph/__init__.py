"""From a .grc file to a run: rewriting, leaving out, generating, running, recording and replaying it."""

__all__ = ["FlowgraphError"]


class FlowgraphError(RuntimeError):
    """A flowgraph that cannot be made or run; the message is one line for the user."""
