#!/bin/sh
# A certificate authority of one's own and a certificate per machine, below the folder given first:
#   sh certificates.sh /etc/bimanual router.example cell1-laptop cell1-robot
# The second word is the router's name as others reach it; the others' names are what access control goes by. Keep ca.key off
# the machines.
set -eu
folder=$1
router=$2
shift 2
mkdir -p "$folder"
cd "$folder"
umask 077
curve="-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes"
if [ ! -f ca.key ]; then
    # shellcheck disable=SC2086
    openssl req -x509 $curve -keyout ca.key -out ca.pem -days 3650 -subj "/CN=bimanual CA" \
        -addext "basicConstraints=critical,CA:TRUE" -addext "keyUsage=critical,keyCertSign" 2>/dev/null
fi
# File, common name, further names.
sign() {
    # shellcheck disable=SC2086
    openssl req $curve -keyout "$1.key" -out "$1.csr" -subj "/CN=$2" 2>/dev/null
    printf 'subjectAltName=DNS:%s\nextendedKeyUsage=serverAuth,clientAuth\nbasicConstraints=CA:FALSE\n' "$2" >"$1.ext"
    openssl x509 -req -in "$1.csr" -CA ca.pem -CAkey ca.key -CAcreateserial -days 825 -extfile "$1.ext" \
        -out "$1.pem" 2>/dev/null
    rm "$1.csr" "$1.ext"
}
sign router "$router"
for name in "$@"; do sign "$name" "$name"; done
