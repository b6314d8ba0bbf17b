"""From a .grc file to a run: rewriting, leaving out, generating, running, recording and replaying it."""
