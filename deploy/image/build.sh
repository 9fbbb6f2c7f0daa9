#!/bin/sh
# An OCI image without a daemon: Debian's python3, wheels with pinned hashes, and a user that is not root.
# Needs root, mmdebstrap and umoci. `make image` runs it; build/image is an OCI layout, for skopeo, podman or crane to push.
set -eu
cd "$(dirname "$0")/../.."
layer=build/image-layer.tar
image=build/image:latest
version=$(basename build/wheelhouse/blockrobot-*.whl | cut -d- -f2)
rm -rf build/image
mmdebstrap --quiet --variant=essential --include=python3,python3-venv \
    --dpkgopt='path-exclude=/usr/share/man/*' --dpkgopt='path-exclude=/usr/share/locale/*' \
    --customize-hook='copy-in build/wheelhouse /tmp' \
    --customize-hook='chroot "$1" python3 -m venv /opt/blockrobot/.venv' \
    --customize-hook='chroot "$1" sh -c "cd /tmp/wheelhouse && /opt/blockrobot/.venv/bin/pip --isolated install --quiet --no-cache-dir \
        --no-index --find-links . --no-deps --require-hashes --requirement wheels.txt"' \
    --customize-hook='rm -r "$1/tmp/wheelhouse"' \
    --customize-hook='echo blockrobot:x:10001:10001::/var/lib/blockrobot:/usr/sbin/nologin >> "$1/etc/passwd"' \
    --customize-hook='echo blockrobot:x:10001: >> "$1/etc/group"' \
    --customize-hook='install -d -m 0700 -o 10001 -g 10001 "$1/var/lib/blockrobot"' \
    bookworm "$layer"
umoci init --layout build/image
umoci new --image "$image"
umoci raw add-layer --image "$image" "$layer"
rm "$layer"
umoci config --image "$image" \
    --config.user 10001:10001 \
    --config.entrypoint blockrobot \
    --config.workingdir /var/lib/blockrobot \
    --config.volume /var/lib/blockrobot \
    --config.exposedports 7272/tcp --config.exposedports 7273/tcp \
    --config.env PATH=/opt/blockrobot/.venv/bin:/usr/sbin:/usr/bin:/sbin:/bin \
    --config.env BLOCKROBOT_HOME=/var/lib/blockrobot \
    --config.env LANG=C.UTF-8 \
    --config.label org.opencontainers.image.title=blockrobot \
    --config.label org.opencontainers.image.version=$version \
    --config.label org.opencontainers.image.licenses=Apache-2.0 \
    --config.label "org.opencontainers.image.revision=$(git rev-parse HEAD)"
umoci gc --layout build/image
