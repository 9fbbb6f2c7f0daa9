"""The organisations of the network and their nodes, as they decide together. Must never let one decide for the others.

org/name -> {name, ca_certificate, status, since_height}; node/name -> {name, organisation, host, p2p_port, api_url,
producer_key, producer_possession, custodian_key, status, since_height}; organisations -> sorted names of the active.
"""


@genesis
def genesis(organisations: list, nodes: list):
    """Write the first organisations [[name, CA certificate]] and nodes [[name, organisation, host, ...]]."""
    names = []
    for name, ca_certificate in organisations:
        entry = {"name": name, "ca_certificate": ca_certificate, "status": "active", "since_height": 0}
        state.put(b"org/" + name.encode(), entry)
        names.append(name)
    state.put(b"organisations", sorted(names))
    for name, organisation, host, p2p_port, api_url, producer_key, producer_possession, custodian_key in nodes:
        entry = {
            "name": name,
            "organisation": organisation,
            "host": host,
            "p2p_port": p2p_port,
            "api_url": api_url,
            "producer_key": producer_key,
            "producer_possession": producer_possession,
            "custodian_key": custodian_key,
            "status": "active",
            "since_height": 0,
        }
        state.put(b"node/" + name.encode(), entry)
