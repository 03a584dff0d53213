"""The twelve nastiest inputs, as docs/hostile-input.md describes them."""

NASTIEST = {
    "suite: a billion laughs": "A suite of 59 lists, each with four copies of the previous list",
    "suite: code: apply": "A suite whose title is `!!python/object/apply:os.mkdir [canary]`",
    "a link to /dev/zero as a network": "A network that is a link to `/dev/zero`",
    "network: weights elsewhere, disguised": "A network whose weights are in another file; "
    "the name of that file is encoded so that a byte search does not find it",
    "network: a loop without end": "A network with a loop of 2^62 iterations",
    "network: a product of 80 GB": "A network of 1 MB with a product that needs 80 GB",
    "checkpoint: a pickle that makes a folder": "A checkpoint with a pickle that calls `os.mkdir`",
    "checkpoint: a bytearray of 32 GB": "A checkpoint whose pickle asks for a `bytearray` of 32 "
    "GB, which `torch.load(weights_only=True)` would allocate",
    "recordings: 10^9 rows announced": "A recording whose metadata declares 10^9 rows",
    "network: a sparse tensor of 32 GiB": "A network of 200 bytes with a sparse tensor of 32 GiB",
    "network: a product of hours when it is loaded": "A network of 6 KB with 200 products of "
    "matrices of 256 MB",
    "network: the smallest integer divided by -1": "A network that divides the smallest integer "
    "by -1, which would end the process",
}


def described(title: str, said: str) -> str:
    """Returns the entry of an input on the page."""
    return f"- {NASTIEST[title]}:\n\n  ```text\n  {said}\n  ```\n"
