# Sourced by the other scripts: installs what is missing on a Debian machine, once.

here=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

say() { printf '\033[1m%s\033[0m\n' "$*" >&2; }

# debian PACKAGE...: installs the packages that are not there yet.
debian() {
  local missing=()
  for p in "$@"; do
    dpkg-query -W -f='${Status}' "$p" 2>/dev/null | grep -q 'install ok installed' || missing+=("$p")
  done
  [ ${#missing[@]} -eq 0 ] && return 0
  if ! command -v apt-get >/dev/null; then
    echo "these packages are missing and this is no Debian machine: ${missing[*]}; install them by hand" >&2
    return 1
  fi
  local sudo=()
  [ "$(id -u)" -eq 0 ] || sudo=(sudo)
  say "installing ${missing[*]}"
  "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get update -qq
  "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
}

# python_env REQUIREMENTS: a virtual environment in .venv with the packages of the file; prints its python.
python_env() {
  local requirements=$1 stamp=$here/.venv/.installed
  debian python3-venv python3-pip >&2
  if ! cmp -s "$requirements" "$stamp"; then
    say "installing the Python packages of ${requirements#"$here"/}"
    python3 -m venv "$here/.venv" >&2
    "$here/.venv/bin/pip" install -q --disable-pip-version-check -r "$requirements" >&2
    cp "$requirements" "$stamp"
  fi
  echo "$here/.venv/bin/python"
}

# What building needs besides Rust.
build_tools() {
  debian g++ libtet1.5-dev
  if ! command -v cargo >/dev/null; then
    if [ -f "$HOME/.cargo/env" ]; then
      . "$HOME/.cargo/env"
    else
      echo "cargo is missing: install Rust 1.89 or newer (https://rustup.rs)" >&2
      return 1
    fi
  fi
}
