"""The masks that tables are made of: name, file, arguments."""
import subprocess
import sys


def built_in(program, work):
    """Every built-in phantom, written into `work`/masks once."""
    for name in subprocess.run([program, "phantom", "list"], capture_output=True, text=True, check=True).stdout.split():
        folder = work / "masks" / name
        if not (folder / "mask.nrrd").exists():
            subprocess.run([program, "phantom", name, "-o", folder], check=True, capture_output=True)
        yield name, folder / "mask.nrrd", []


def shared(data, left_out=()):
    """The masks in `data`, those aside whose name begins with one of `left_out`."""
    if not data.is_dir():
        print(f"SKIPPED: {data} is not there; only the built-in phantoms are run", file=sys.stderr)
        return
    for path in sorted([*data.glob("phantoms/*.n*"), *data.glob("*.nrrd"), *data.glob("*.nii.gz"), *data.glob("*.mha")]):
        name = path.name.split(".")[0]
        if path.suffix not in (".nrrd", ".gz", ".mha"):
            continue
        if left_out and name.startswith(left_out):
            print(f"left out: {name}", file=sys.stderr)
            continue
        # Which labels are lumen has to be said.
        yield name, path, ["--set", "input.label=[1, 2, 4]"] if "multilabel" in name else []
        if "multilabel" in name:
            yield name + ", label 1", path, ["--set", "input.label=1"]
