"""``python -m radalt``: the command ``radalt``."""

from .evaluation.programs import main

if __name__ == "__main__":
    raise SystemExit(main())
