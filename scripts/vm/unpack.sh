# shellcheck shell=bash
# Sourced: `unpack PACKAGES INTO NAME..` fetches Debian packages into folder PACKAGES and unpacks them under INTO.
unpack() {
    local packages=$1 into=$2 name
    shift 2
    for name; do
        if ! compgen -G "$packages/${name}_*.deb" >/dev/null; then
            (cd "$packages" && apt-get download -q -o APT::Sandbox::User=root "$name" >/dev/null) || {
                echo "softrig: apt cannot download $name; sudo apt-get update, delete ${packages%/*} and try again" >&2
                exit 2
            }
        fi
        dpkg -x "$packages/${name}"_*.deb "$into"
    done
}
