#!/usr/bin/env python3
"""Verifies a Cairn bundle from the public formats alone, sharing no line with Cairn.

Written from C2SP's signed-note, tlog-checkpoint, tlog-proof and tlog-cosignature, RFC 6962, DSSE 1.0 and RFC 8032, and
for Cairn's own owner record and leaf from their descriptions; all that is in formats.py. Needs Python 3.9 and `cryptography`.

    verify_bundle.py BUNDLE --vkey FILE [--witness VKEY ...] [--quorum N]   verdict, exit code 0 or 1
    verify_bundle.py --make DIR [--seed TEXT]     makes a log of its own with a cosigned bundle, the other way round
    verify_bundle.py --vectors DIR                RFC 6962 cases of transparency-dev/merkle
    verify_bundle.py --signatures FILE            [{"message", "pub_key", "signature"}] in hex: one letter a case, V or X

A folder BUNDLE holds record.json (DSSE envelope), record.tlog-proof, and where the owner shows them signal.png,
signal.wav and signal.txt with signal.salt. The key to pin comes from the registry, not from the bundle.
"""

import argparse
import base64
import json
import os
import sys

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from formats import (
    COSIGNATURE,
    DASH,
    ED25519,
    MAX_ENVELOPE,
    MAX_NOTE,
    PAYLOAD_TYPE,
    Refused,
    Verifier,
    check_consistency,
    check_inclusion,
    cosignatures,
    good_point,
    hex32,
    inclusion_path,
    key_id,
    leaf_hash,
    make_leaf,
    pae,
    parse_checkpoint,
    parse_envelope,
    parse_record,
    parse_tlog_proof,
    sha256,
    signature_holds,
    tree_root,
    verify_note,
)

# The verdict.


def read_file(path, most):
    with open(path, "rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise Refused("file", f"{path} is larger than {most} bytes")
    return data


def text_of(data, code):
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as e:
        raise Refused(code, f"not UTF-8: {e}") from None


def verify(bundle, log, witnesses, quorum, say):
    """Raises `Refused`; tells what holds, in the order in which it is established."""
    proof = text_of(read_file(os.path.join(bundle, "record.tlog-proof"), MAX_NOTE + 8192), "tlog-proof")
    index, hashes, note = parse_tlog_proof(proof)
    origin, size, root = parse_checkpoint(verify_note(note, [log]))
    if origin != log.name:
        raise Refused("origin", f"a checkpoint of log {origin!r}, pinned is {log.name!r}")
    say("checkpoint", f"signed by {log.name}, {size} entries")
    seen = cosignatures(note, witnesses)
    for name, time in seen:
        say("cosignature", f"witness {name} saw it at {time} (seconds since 1970): the record is not later")
    if len(seen) < quorum:
        raise Refused("quorum", f"{len(seen)} witnesses cosigned, {quorum} are asked for")

    kind, body, signatures = parse_envelope(read_file(os.path.join(bundle, "record.json"), MAX_ENVELOPE))
    signed = pae(kind, body)
    record = parse_record(body)
    owner = bytes.fromhex(record["owner_key"])
    if not good_point(owner):
        raise Refused("owner-key", "not a canonical Ed25519 key, or one of small order")
    by_owner = [s for s in signatures if signature_holds(owner, signed, s)]
    if not by_owner:
        raise Refused("owner-signature", f"no signature is by the owner key {owner.hex()}")
    say("owner", f"signed by {owner.hex()}")
    if not any(signature_holds(log.key, signed, s) for s in signatures):
        raise Refused("registry-signature", "no signature is by the log's key")
    say("registry", "countersigned")
    if record["origin"] != origin:
        raise Refused("origin", f"a record for log {record['origin']!r}")
    if record["seen"]["size"] > index:
        raise Refused("seen", f"the record has seen {record['seen']['size']} entries, but is entry {index}")

    leaf = make_leaf(record, sha256(signed), by_owner[0])
    check_inclusion(leaf_hash(leaf), index, size, hashes, root)
    say("inclusion", f"entry {index} of {size}")
    def part(name):
        path = os.path.join(bundle, name)
        return read_file(path, 64 << 20) if os.path.exists(path) else b""

    names = ("signal.png", "signal.wav", "signal.txt")
    parts, salt = [part(name) for name in names], os.path.join(bundle, "signal.salt")
    if any(parts) and os.path.exists(salt):
        salt = hex32(text_of(read_file(salt, 100), "signal").strip(), "signal.salt")
        if any(parts[1:]):
            framed = b"".join(len(p).to_bytes(8, "big") + p for p in parts)
            commitment = sha256(b"cairn hidden signal v2\0", salt, framed)
        else:
            commitment = sha256(b"cairn hidden signal v1\0", salt, parts[0])
        there = " and ".join(name for name, p in zip(names, parts) if p)
        if commitment.hex() != record["digests"].get("hidden_signal"):
            raise Refused("signal", f"{there} is not the hidden signal of the record")
        say("signal", f"{there} is the hidden signal")
    say("record", f"{record['kind']} by {record['identity']['contributor']!r}, scene {record['scene']!r}")


# The other way round: a log of Python's making.


def make(folder, seed):
    def key(label):
        return Ed25519PrivateKey.from_private_bytes(sha256(seed.encode(), b"/", label.encode()))

    def public(private):
        return private.public_key().public_bytes(serialization.Encoding.Raw, serialization.PublicFormat.Raw)

    def vkey(name, private, kind):
        typed = bytes([kind]) + public(private)
        return f"{name}+{key_id(name, typed).hex()}+{base64.b64encode(typed).decode()}"

    def line(name, private, kind, blob):
        kid = key_id(name, bytes([kind]) + public(private))
        return f"{DASH}{name} {base64.b64encode(kid + blob).decode()}\n"

    origin, log, owner = "python.example/log", key("log"), key("owner")
    salt, others = sha256(b"salt"), [leaf_hash(sha256(b"leaf", bytes([i])) * 5 + b"xx") for i in range(10)]
    photographs = sorted(sha256(b"photograph", bytes([i])) for i in range(3))
    seen = {"size": 3, "root": tree_root(others[:3]).hex()}
    record = {"version": 1, "kind": "contribution", "origin": origin, "scene": "caf\u00e9", "scene_salt": salt.hex()}
    record.update(identity={"number": 1, "contributor": "Ada"}, owner_key=public(owner).hex())
    record.update(digests={"photographs": tree_root([leaf_hash(p) for p in photographs]).hex()})
    record.update(seed=str(2**64 - 1), purpose="credit", nonce=sha256(b"nonce").hex(), seen=seen)
    # Blanks on purpose: signatures are over the bytes, not over somebody's way to write JSON.
    body = json.dumps(record, ensure_ascii=False, indent=1).encode()
    signed = pae(PAYLOAD_TYPE, body)
    signature = owner.sign(signed)
    both = [{"sig": base64.b64encode(s).decode()} for s in (signature, log.sign(signed))]
    envelope = {"payload": base64.b64encode(body).decode(), "payloadType": PAYLOAD_TYPE, "signatures": both}

    index = 7
    leaves = [*others[:index], leaf_hash(make_leaf(record, sha256(signed), signature)), *others[index:]]
    text = f"{origin}\n{len(leaves)}\n{base64.b64encode(tree_root(leaves)).decode()}\n"
    note = text + "\n" + line(origin, log, ED25519, log.sign(text.encode()))
    keys = {"log.vkey": vkey(origin, log, ED25519)}
    for number, time in ((1, 1_700_000_000), (2, 1_700_000_007)):
        name, witness = f"witness-{number}.example", key(f"witness {number}")
        cosigned = witness.sign(f"cosignature/v1\ntime {time}\n{text}".encode())
        note += line(name, witness, COSIGNATURE, time.to_bytes(8, "big") + cosigned)
        keys[f"witness-{number}.vkey"] = vkey(name, witness, COSIGNATURE)
    path = "".join(base64.b64encode(h).decode() + "\n" for h in inclusion_path(leaves, index))
    files = {"record.json": json.dumps(envelope), "record.tlog-proof": f"c2sp.org/tlog-proof@v1\nindex {index}\n{path}\n{note}"}
    os.makedirs(folder, exist_ok=True)
    for name, content in {**files, **{name: vkey + "\n" for name, vkey in keys.items()}}.items():
        with open(os.path.join(folder, name), "w", encoding="utf-8", newline="") as file:
            file.write(content)


# Published cases.


def run_case(case, kind):
    data = {k: base64.b64decode(case.get(k) or "") for k in ("root", "root1", "root2", "leafHash")}
    proof = [base64.b64decode(h) for h in case["proof"] or []]
    try:
        if kind == "inclusion":
            check_inclusion(data["leafHash"], case["leafIdx"], case["treeSize"], proof, data["root"])
        else:
            check_consistency(case["size1"], case["size2"], proof, data["root1"], data["root2"])
        return None
    except Refused as e:
        return str(e)


def vectors(folder):
    """One case has 12 bytes for roots and is refused here for that; with 32 bytes in their place it must be taken."""
    wrong, stand_ins, counts = [], 0, {}
    for kind in ("inclusion", "consistency"):
        for place, _, names in os.walk(os.path.join(folder, kind)):
            for name in names:
                with open(os.path.join(place, name), "rb") as file:
                    case = json.load(file)
                counts[kind] = counts.get(kind, 0) + 1
                if kind == "consistency" and not case["wantErr"] and len(base64.b64decode(case["root1"])) != 32:
                    stand_ins += 1
                    if run_case(case, kind) is None:
                        wrong.append(f"{name}: roots of 12 bytes are taken")
                    for root in ("root1", "root2"):
                        case[root] = base64.b64encode(base64.b64decode(case[root]).ljust(32, b"\0")).decode()
                refused = run_case(case, kind)
                if (refused is not None) != case["wantErr"]:
                    wrong.append(f"{os.path.join(place, name)}: {refused}")
    print(f"{counts.get('inclusion', 0)} inclusion and {counts.get('consistency', 0)} consistency cases, {stand_ins} with stand-ins")
    for line in wrong:
        print("BAD  " + line)
    return not wrong and counts == {"inclusion": 98, "consistency": 98} and stand_ins == 1


def signatures(path):
    with open(path, "rb") as file:
        cases = json.load(file)
    parts = ([bytes.fromhex(case[k]) for k in ("pub_key", "message", "signature")] for case in cases)
    print("".join("V" if signature_holds(*part) else "X" for part in parts))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle", nargs="?")
    parser.add_argument("--vkey", metavar="FILE", help="the log's key, from the registry")
    parser.add_argument("--witness", metavar="VKEY", action="append", default=[], help="a witness's key, itself or its file")
    parser.add_argument("--quorum", type=int, metavar="N", default=0, help="witnesses that must have cosigned")
    parser.add_argument("--make", metavar="DIR")
    parser.add_argument("--seed", default="cairn")
    parser.add_argument("--vectors", metavar="DIR")
    parser.add_argument("--signatures", metavar="FILE")
    args = parser.parse_args()
    if args.make:
        return make(args.make, args.seed)
    if args.vectors:
        return sys.exit(0 if vectors(args.vectors) else 1)
    if args.signatures:
        return signatures(args.signatures)
    if not args.bundle or not args.vkey:
        parser.error("BUNDLE and --vkey FILE are needed")
    try:
        log = Verifier(text_of(read_file(args.vkey, 4096), "vkey"), ED25519)
        keys = (text_of(read_file(w, 4096), "vkey") if os.path.exists(w) else w for w in args.witness)
        witnesses = [Verifier(vkey, COSIGNATURE) for vkey in keys]
        verify(args.bundle, log, witnesses, args.quorum, lambda code, what: print(f"ok   {code}: {what}"))
    except (Refused, OSError) as e:
        print(f"BAD  {getattr(e, 'code', 'file')}: {e}")
        print("invalid")
        sys.exit(1)
    print("valid under the pinned key")


if __name__ == "__main__":
    main()
