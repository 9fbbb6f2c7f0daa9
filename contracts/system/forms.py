"""What a proposal of the contract `membership` must look like. Must never read or keep anything: it only looks.

Whether a proposal fits what is there (names, limits, keys that are taken) is `membership`'s to say.
"""

KEY_BYTES = 33
SERIAL_BYTES = 20
NAME_MAX_CHARS = 40
NAME_CHARS = "abcdefghijklmnopqrstuvwxyz0123456789-"
HOST_MAX_CHARS = 253
LABEL_MAX_CHARS = 63
LABEL_CHARS = "abcdefghijklmnopqrstuvwxyz0123456789-_"
ADDRESS_CHARS = "0123456789abcdef:."
URL_MAX_CHARS = 256
PORT_MAX_CHARS = 5
CERTIFICATE_CHARS = "abcdefghijklmnopqrstuvwxyz0123456789+/= -\n"
CERTIFICATE_MAX_CHARS = 4096
CERTIFICATE_BEGIN = "-----BEGIN CERTIFICATE-----"
KEYS_MAX_COUNT = 16
POSSESSION_TAG = "blockrobot/producer-possession"
POINT_TAG = "blockrobot/point"
ONE = b"\x00" * 31 + b"\x01"
FIELDS = {
    "add_org": {"name": "str", "ca_certificate": "str", "admins": "list", "registrars": "list"},
    "remove_org": {"name": "str"},
    "replace_ca": {"organisation": "str", "ca_certificate": "str"},
    "replace_keys": {"organisation": "str", "admins": "list", "registrars": "list"},
    "add_node": {
        "name": "str",
        "organisation": "str",
        "host": "str",
        "p2p_port": "int",
        "api_url": "str",
        "producer_key": "bytes",
        "producer_possession": "bytes",
        "custodian_key": "bytes",
    },
    "remove_node": {"name": "str"},
    "move_node": {"name": "str", "host": "str", "p2p_port": "int", "api_url": "str"},
    "rekey_producer": {"node": "str", "producer_key": "bytes", "producer_possession": "bytes"},
    "revoke_certificate": {"organisation": "str", "serial": "bytes"},
}


@view
def check(kind: str, arguments: dict) -> bool:
    """Refuse a proposal that is not well formed; otherwise True."""
    check_fields(kind, arguments)
    if kind == "add_org":
        check_name(arguments["name"])
    if kind == "add_org" or kind == "replace_ca":
        check_certificate(arguments["ca_certificate"])
    if kind == "add_org" or kind == "replace_keys":
        check_keys(arguments["admins"], arguments["registrars"])
    if kind == "revoke_certificate":
        require(len(arguments["serial"]) == SERIAL_BYTES, "SERIAL_WRONG", "A certificate's serial number has 20 bytes here.")
    if kind == "rekey_producer":
        check_possession(arguments["node"], arguments["producer_key"], arguments["producer_possession"])
    if kind == "add_node" or kind == "move_node":
        check_name(arguments["name"])
        check_place(arguments)
    if kind == "add_node":
        check_node_keys(arguments)
    return True


def is_of(value: object, kind: str) -> bool:
    if kind == "str":
        return isinstance(value, str)
    if kind == "int":
        return isinstance(value, int)
    if kind == "bytes":
        return isinstance(value, bytes)
    return isinstance(value, list)


def check_fields(kind: str, arguments: dict):
    require(kind in FIELDS, "KIND_UNKNOWN", "Membership knows no proposal of this kind.")
    fields = FIELDS[kind]
    require(len(arguments) == len(fields), "FIELDS_WRONG", "The proposal lacks a field, or has one too many.")
    for field, wanted in fields.items():
        known = field in arguments and is_of(arguments[field], wanted)
        require(known, "FIELDS_WRONG", f"The proposal needs the field {field} of type {wanted}.")


def is_of_these(text: str, characters: str) -> bool:
    """Tell whether a text is of these characters alone, in small letters or capitals."""
    return len(text.lower().strip(characters)) == 0


def check_name(name: str):
    require(0 < len(name) and len(name) <= NAME_MAX_CHARS, "NAME_WRONG", "A name has 1 to 40 characters.")
    for character in name:
        require(character in NAME_CHARS, "NAME_WRONG", "A name is of small letters, digits and hyphens.")


def check_certificate(certificate: str):
    known = is_of_these(certificate, CERTIFICATE_CHARS) and certificate.startswith(CERTIFICATE_BEGIN)
    require(known and len(certificate) <= CERTIFICATE_MAX_CHARS, "CERTIFICATE_WRONG", "That is no certificate in PEM.")


def check_keys(admins: list, registrars: list):
    require(len(admins) > 0, "ADMINS_MISSING", "An organisation needs at least one admin.")
    for keys in [admins, registrars]:
        require(len(keys) <= KEYS_MAX_COUNT, "KEYS_TOO_MANY", "An organisation has at most 16 admins and 16 registrars.")
        seen = {}
        for key in keys:
            require(isinstance(key, bytes) and len(key) == KEY_BYTES, "KEY_SIZE_WRONG", "A member's key has 33 bytes.")
            require(key not in seen, "KEY_TWICE", "A key is named twice.")
            check_point(key)
            seen[key] = True


def check_point(key: bytes):
    """Refuse a key that nobody can have: some key can be recovered from r and s = 1 only if r is a point's x."""
    known = key[0] == 2 or key[0] == 3
    if known:
        known = recover(POINT_TAG, key[1:] + ONE + b"\x00", b"") is not None
    require(known, "KEY_WRONG", "That is no public key: nobody can have its secret half.")


def check_possession(name: str, key: bytes, proof: bytes):
    require(len(key) == KEY_BYTES, "KEY_SIZE_WRONG", "A node's key has 33 bytes.")
    held = False
    for recovery in [b"\x00", b"\x01"]:
        if recover(POSSESSION_TAG, proof + recovery, name.encode()) == key:
            held = True
    require(held, "POSSESSION_WRONG", "The node does not prove that it holds this producer key.")


def is_host(host: str) -> bool:
    """Tell whether clients would look for it: an IPv6 address, or a name of which IDNA takes every label."""
    if ":" in host:
        return is_of_these(host, ADDRESS_CHARS)
    for label in host.split("."):
        known = 0 < len(label) and len(label) <= LABEL_MAX_CHARS and is_of_these(label, LABEL_CHARS)
        if not known or label.startswith("-") or label.endswith("-"):
            return False
    return True


def is_port(port: int) -> bool:
    return 0 < port and port < 65536


def is_url(url: str) -> bool:
    """Tell whether it is a scheme and a host, at most with a port."""
    if not url.startswith("https://") and not url.startswith("http://"):
        return False
    place = url[url.find("://") + 3 :]
    if place.startswith("["):
        end = place.find("]")
        host, rest = [place[1:end], place[end + 1 :]]
        known = end > 0 and ":" in host and is_host(host)
    else:
        host = place.split(":")[0]
        known, rest = [is_host(host), place[len(host) :]]
    if known and len(rest) > 0:
        port = rest[1:]
        known = rest.startswith(":") and port.isdigit() and len(port) <= PORT_MAX_CHARS and is_port(int(port))
    return known


def check_place(node: dict):
    """Refuse an address at which nobody could reach a node."""
    host = node["host"]
    require(len(host) <= HOST_MAX_CHARS and is_host(host), "HOST_WRONG", "That is no host.")
    require(is_port(node["p2p_port"]), "PORT_WRONG", "A port is 1 to 65535.")
    url = node["api_url"]
    known = len(url) <= URL_MAX_CHARS and is_url(url)
    require(known, "URL_WRONG", "An API address is https://HOST[:PORT], with nothing behind it.")


def check_node_keys(node: dict):
    producer_key, custodian_key = [node["producer_key"], node["custodian_key"]]
    if len(custodian_key) > 0:
        require(len(custodian_key) == KEY_BYTES, "KEY_SIZE_WRONG", "A node's key has 33 bytes.")
        check_point(custodian_key)
        require(custodian_key != producer_key, "KEY_TAKEN", "The two roles need a key each.")
    if len(producer_key) > 0:
        check_possession(node["name"], producer_key, node["producer_possession"])
    else:
        require(len(node["producer_possession"]) == 0, "POSSESSION_WRONG", "There is no producer key to hold.")
