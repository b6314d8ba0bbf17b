"""Input from users: files, YAML and numbers, as typed, validated dataclasses, and back to plain mappings.

- `files`: regular files of bounded size, and a strict YAML reader
- `mappings`: typed and validated dataclasses from mappings
- `settings`: fields that declare their limits, and the check of them
- `messages`: the error of unusable input, and values for messages
"""

from .files import check_file, load_yaml, read_bytes, read_csv, read_text, write_yaml
from .mappings import LARGEST, arguments, build, convert, plain, plain_json, quantity, whole
from .messages import MINUS, InputError, allowed, check_range, did_you_mean, shown
from .settings import Settings, setting
