"""Files that are whole or absent, say what they are, and are read without unpickling."""

from pemirl_trl.files.cards import Card, parse_card
from pemirl_trl.files.headers import check_fields, parse_json
from pemirl_trl.files.staging import (
    atomic_path,
    content_digest,
    expanded,
    file_digest,
    has_live_owner,
    regular_file,
    staging_folder,
    writing,
)
from pemirl_trl.files.tensors import read_tensors, write_tensors
from pemirl_trl.files.weights import (
    load_weights,
    misfits,
    read_metadata,
    read_weights,
    save_weights,
)

__all__ = [
    "Card",
    "atomic_path",
    "check_fields",
    "content_digest",
    "expanded",
    "file_digest",
    "has_live_owner",
    "load_weights",
    "misfits",
    "parse_card",
    "parse_json",
    "read_metadata",
    "read_tensors",
    "read_weights",
    "regular_file",
    "save_weights",
    "staging_folder",
    "write_tensors",
    "writing",
]
