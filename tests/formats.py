"""The public formats that verify_bundle.py checks, each written anew from its specification.

Ed25519 after RFC 8032, strictly; C2SP signed notes, checkpoints, cosignatures and tlog-proofs; RFC 6962 trees; DSSE 1.0;
and Cairn's own owner record and leaf. Whatever is wrong is raised as `Refused`.
"""

import base64
import binascii
import hashlib
import json
import re
import unicodedata

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

MAX_ENVELOPE, MAX_NOTE = 64 * 1024, 1_000_000
PAYLOAD_TYPE = "application/vnd.cairn.owner-record.v1+json"
DASH = "\u2014 "
ED25519, COSIGNATURE = 1, 4


class Refused(Exception):
    """What is wrong, in words; `code` names the kind of fault."""

    def __init__(self, code, why):
        super().__init__(why)
        self.code = code


def sha256(*parts):
    return hashlib.sha256(b"".join(parts)).digest()


def unbase64(text, code, what):
    """Standard base64 with padding, in its one spelling."""
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        raise Refused(code, f"{what}: {text[:60]!r} is not base64") from None
    if base64.b64encode(data).decode() != text:
        raise Refused(code, f"{what}: {text[:60]!r} is not canonical base64")
    return data


# Ed25519, strictly (RFC 8032, and "Taming the many EdDSAs" on where verifiers disagree). The library checks the
# equation without cofactor; encodings and orders are checked here, with integers.

P = 2**255 - 19
L = 2**252 + 27742317777372353535851937790883648493
D = -121665 * pow(121666, P - 2, P) % P


def decompress(data):
    """(x, y) of a point's one canonical encoding; None for anything else."""
    number = int.from_bytes(data, "little")
    sign, y = number >> 255, number & (2**255 - 1)
    if y >= P:
        return None
    x2 = (y * y - 1) * pow(D * y * y + 1, P - 2, P) % P
    x = pow(x2, (P + 3) // 8, P)
    if (x * x - x2) % P:
        x = x * pow(2, (P - 1) // 4, P) % P
    if (x * x - x2) % P or (x == 0 and sign):
        return None
    return (P - x if x & 1 != sign else x), y


def has_small_order(point):
    for _ in range(3):
        (x1, y1), (x2, y2) = point, point
        t = D * x1 * x2 * y1 * y2 % P
        x = (x1 * y2 + x2 * y1) * pow(1 + t, P - 2, P) % P
        point = x, (y1 * y2 + x1 * x2) * pow(1 - t, P - 2, P) % P
    return point == (0, 1)


def good_point(data):
    point = decompress(data)
    return point is not None and not has_small_order(point)


def signature_holds(key, message, signature):
    """Strict: one spelling of key, R and S, none of small order."""
    if len(key) != 32 or len(signature) != 64 or int.from_bytes(signature[32:], "little") >= L:
        return False
    if not good_point(key) or not good_point(signature[:32]):
        return False
    try:
        Ed25519PublicKey.from_public_bytes(key).verify(signature, message)
        return True
    except (InvalidSignature, ValueError):
        return False


# Signed notes, as Go's golang.org/x/mod/sumdb/note has them.


class Verifier:
    """A vkey: name+hex(key id)+base64(type | key)."""

    def __init__(self, vkey, kind):
        parts = vkey.strip().split("+", 2)
        if len(parts) != 3:
            raise Refused("vkey", f"{vkey[:60]!r} has not three parts")
        self.name, stated, typed = parts[0], parts[1], unbase64(parts[2], "vkey", "key")
        check_name(self.name)
        if not re.fullmatch("[0-9a-fA-F]{8}", stated):
            raise Refused("vkey", f"key id {stated!r} is not 8 hexadecimal digits")
        self.id = key_id(self.name, typed)
        if self.id.hex() != stated.lower():
            raise Refused("vkey", f"{self.name} states key id {stated}, its key has {self.id.hex()}")
        if typed[:1] != bytes([kind]):
            raise Refused("vkey", f"{self.name} is a key of type {typed[:1].hex()}, expected {kind:02x}")
        self.key = typed[1:]
        if len(self.key) != 32 or not good_point(self.key):
            raise Refused("vkey", f"{self.name}: not a canonical Ed25519 key, or one of small order")


def key_id(name, typed):
    return sha256(name.encode(), b"\n", typed)[:4]


def check_name(name):
    if not name or "+" in name or any(c.isspace() or unicodedata.category(c) == "Cc" for c in name):
        raise Refused("note", f"key name {name[:60]!r} is empty or has blanks or '+'")


def parse_note(note):
    """(text with its final newline, [(name, key id, signature)])."""
    if len(note.encode()) > MAX_NOTE:
        raise Refused("note", "larger than a megabyte")
    split = note.rfind("\n\n")
    if split < 0:
        raise Refused("note", "no blank line between text and signatures")
    text, lines = note[: split + 1], note[split + 2 :]
    if any(c < " " and c != "\n" for c in text):
        raise Refused("note", "the text holds a control character")
    if not lines.endswith("\n"):
        raise Refused("note", "no signature line, or the last one has no end")
    signatures = []
    for line in lines[:-1].split("\n"):
        name, _, blob = line[len(DASH) :].partition(" ")
        if not line.startswith(DASH) or not blob:
            raise Refused("note", f"{line[:60]!r} is no signature line")
        check_name(name)
        blob = unbase64(blob, "note", f"signature of {name}")
        if len(blob) < 5:
            raise Refused("note", f"signature of {name}: no more than a key id")
        signatures.append((name, blob[:4], blob[4:]))
    if len(signatures) > 100:
        raise Refused("note", f"{len(signatures)} signatures, at most 100")
    return text, signatures


def verify_note(note, known):
    """The text, where a known signer signed it and no known signer's signature is bad; unknown ones are ignored."""
    text, signatures = parse_note(note)
    signed = False
    for name, kid, signature in signatures:
        for verifier in known:
            if (verifier.name, verifier.id) == (name, kid):
                if not signature_holds(verifier.key, text.encode(), signature):
                    raise Refused("checkpoint-signature", f"the signature of {name} does not verify")
                signed = True
    if not signed:
        raise Refused("checkpoint-signature", "nobody known signed the checkpoint")
    return text


def decimal(text, code, what):
    if not re.fullmatch("0|[1-9][0-9]{0,19}", text) or int(text) >= 2**64:
        raise Refused(code, f"{what}: {text[:60]!r} is not a decimal number below 2^64")
    return int(text)


def hash32(text, code, what):
    data = unbase64(text, code, what)
    if len(data) != 32:
        raise Refused(code, f"{what}: {len(data)} bytes, expected 32")
    return data


def parse_checkpoint(text):
    """(origin, size, root)."""
    lines = text[:-1].split("\n")
    if not text.endswith("\n") or len(lines) < 3 or not all(lines):
        raise Refused("checkpoint", "not origin, size and root, and lines that are not empty")
    return lines[0], decimal(lines[1], "checkpoint", "size"), hash32(lines[2], "checkpoint", "root")


def cosignatures(note, witnesses):
    """[(name, unix seconds)] of the witnesses whose cosignature holds; a bad one condemns the note."""
    text, signatures = parse_note(note)
    found = {}
    for name, kid, blob in signatures:
        for witness in witnesses:
            if (witness.name, witness.id) != (name, kid):
                continue
            time = int.from_bytes(blob[:8], "big")
            message = f"cosignature/v1\ntime {time}\n{text}".encode()
            if len(blob) != 72 or not signature_holds(witness.key, message, blob[8:]):
                raise Refused("cosignature", f"the cosignature of {name} does not verify")
            found[name, witness.key] = time
    return [(name, time) for (name, _), time in found.items()]


# RFC 6962: the definitions of 2.1.1 and 2.1.2, turned round so that they eat a proof.


def leaf_hash(data):
    return sha256(b"\0", data)


def node_hash(left, right):
    return sha256(b"\1", left, right)


def tree_root(leaves):
    if len(leaves) < 2:
        return leaves[0] if leaves else sha256()
    k = 1 << ((len(leaves) - 1).bit_length() - 1)
    return node_hash(tree_root(leaves[:k]), tree_root(leaves[k:]))


def inclusion_path(leaves, index):
    if len(leaves) < 2:
        return []
    k = 1 << ((len(leaves) - 1).bit_length() - 1)
    if index < k:
        return inclusion_path(leaves[:k], index) + [tree_root(leaves[k:])]
    return inclusion_path(leaves[k:], index - k) + [tree_root(leaves[:k])]


def check_hashes(proof, *roots):
    if any(len(h) != 32 for h in [*proof, *roots]):
        raise Refused("proof", "a hash that is not 32 bytes")


def root_by_inclusion(leaf, index, size, proof):
    check_hashes(proof, leaf)
    if index >= size:
        raise Refused("proof", f"index {index} lies outside a tree of size {size}")

    def climb(index, size, proof):
        if size == 1:
            if proof:
                raise Refused("proof", f"{len(proof)} hashes are left over")
            return leaf
        if not proof:
            raise Refused("proof", "hashes are missing")
        k = 1 << ((size - 1).bit_length() - 1)
        if index < k:
            return node_hash(climb(index, k, proof[:-1]), proof[-1])
        return node_hash(proof[-1], climb(index - k, size - k, proof[:-1]))

    return climb(index, size, proof)


def check_inclusion(leaf, index, size, proof, root):
    check_hashes([], root)
    if root_by_inclusion(leaf, index, size, proof) != root:
        raise Refused("proof", "the inclusion proof leads to another root")


def check_consistency(first, second, proof, first_root, second_root):
    check_hashes(proof, first_root, second_root)
    if not 0 < first <= second:
        raise Refused("proof", f"no consistency from size {first} to {second}")

    def climb(m, n, proof, whole):
        """The roots of the first m and of all n leaves of a subtree; `whole` while the first tree's root is one."""
        if m == n:
            if whole:
                seed, proof = first_root, proof
            elif proof:
                seed, proof = proof[-1], proof[:-1]
            else:
                raise Refused("proof", "hashes are missing")
            if proof:
                raise Refused("proof", f"{len(proof)} hashes are left over")
            return seed, seed
        if not proof:
            raise Refused("proof", "hashes are missing")
        k, last = 1 << ((n - 1).bit_length() - 1), proof[-1]
        if m <= k:
            old, new = climb(m, k, proof[:-1], whole)
            return old, node_hash(new, last)
        old, new = climb(m - k, n - k, proof[:-1], False)
        return node_hash(last, old), node_hash(last, new)

    if climb(first, second, proof, True) != (first_root, second_root):
        raise Refused("proof", "the consistency proof leads to other roots")


def parse_tlog_proof(text):
    """(index, hashes, checkpoint)."""
    head, blank, checkpoint = text.partition("\n\n")
    lines = head.split("\n")
    if not blank or lines[0] != "c2sp.org/tlog-proof@v1":
        raise Refused("tlog-proof", "not a c2sp.org/tlog-proof@v1 with a checkpoint")
    lines = lines[1:]
    if lines and lines[0].startswith("extra "):
        unbase64(lines.pop(0)[6:], "tlog-proof", "extra")
    if not lines or not lines[0].startswith("index "):
        raise Refused("tlog-proof", "no index")
    if len(lines) > 65:
        raise Refused("tlog-proof", "more than 64 hashes")
    index = decimal(lines[0][6:], "tlog-proof", "index")
    return index, [hash32(line, "tlog-proof", "hash") for line in lines[1:]], checkpoint


# DSSE and the owner record.


def pae(kind, body):
    kind = kind.encode()
    return b"DSSEv1 %d %s %d %s" % (len(kind), kind, len(body), body)


def read_json(data, code):
    def once(pairs):
        if len(dict(pairs)) != len(pairs):
            raise Refused(code, "a field stands twice")
        return dict(pairs)

    def refuse(constant):
        raise Refused(code, f"{constant} is no JSON")

    try:
        return json.loads(data.decode("utf-8"), object_pairs_hook=once, parse_constant=refuse)
    except (ValueError, RecursionError) as e:
        raise Refused(code, f"not JSON: {e}") from None


def either_base64(text, what):
    """Standard or URL-safe, padding as it comes."""
    if not isinstance(text, str) or ("+" in text or "/" in text) and ("-" in text or "_" in text):
        raise Refused("envelope", f"{what} is not base64")
    text = text.replace("-", "+").replace("_", "/").rstrip("=")
    return unbase64(text + "=" * (-len(text) % 4), "envelope", what)


def parse_envelope(data):
    """(payload type, body, [signature])."""
    if len(data) > MAX_ENVELOPE:
        raise Refused("envelope", f"{len(data)} bytes, at most {MAX_ENVELOPE}")
    json_ = read_json(data, "envelope")
    if not isinstance(json_, dict) or not isinstance(json_.get("signatures"), list):
        raise Refused("envelope", "no DSSE envelope")
    if not 1 <= len(json_["signatures"]) <= 16 or not all(isinstance(s, dict) for s in json_["signatures"]):
        raise Refused("envelope", "not 1 to 16 signatures")
    if json_.get("payloadType") != PAYLOAD_TYPE:
        raise Refused("envelope", f"payloadType {str(json_.get('payloadType'))[:80]!r} is unknown")
    signatures = [either_base64(s.get("sig"), "signature") for s in json_["signatures"]]
    return PAYLOAD_TYPE, either_base64(json_.get("payload"), "payload"), signatures


KINDS = {"claim": 1, "contribution": 2, "training": 3, "revocation": 4, "rotation": 5, "dispute": 6, "binding": 8}
DIGESTS = ("marked_field", "detector", "hidden_signal", "photographs", "base_field", "share_table", "training_configuration")
MARK = ("marked_field", "detector", "hidden_signal")
NEEDS = {
    "claim": ("photographs",),
    "contribution": ("photographs",),
    "training": ("share_table", "training_configuration"),
}


def fields(value, needed, allowed, where):
    if not isinstance(value, dict):
        raise Refused("record", f"{where} is no object")
    missing, unknown = set(needed) - set(value), set(value) - set(needed) - set(allowed)
    if missing or unknown:
        raise Refused("record", f"{where}: missing {sorted(missing)}, unknown {sorted(unknown)}")
    return value


def hex32(value, what):
    if not isinstance(value, str) or not re.fullmatch("[0-9a-f]{64}", value):
        raise Refused("record", f"{what} is not 64 lowercase hexadecimal digits")
    return bytes.fromhex(value)


def short_text(value, what):
    control = not isinstance(value, str) or any(unicodedata.category(c) == "Cc" for c in value)
    if control or not 1 <= len(value.encode()) <= 256 or value.strip() != value:
        raise Refused("record", f"{what} is not 1 to 256 bytes without control characters or outer blanks")


def whole(value, low, below, what):
    if type(value) is not int or not low <= value < below:
        raise Refused("record", f"{what} is {value!r}, expected a whole number from {low} and below {below}")


def parse_record(body):
    """The record, every rule that needs nothing else checked."""
    record = read_json(body, "record")
    if not isinstance(record, dict) or type(record.get("version")) is not int or record["version"] != 1:
        raise Refused("record", "not an owner record of version 1")
    needed = ("version", "kind", "origin", "scene", "scene_salt", "identity", "owner_key", "digests", "purpose")
    fields(record, (*needed, "nonce", "seen"), ("seed", "replaces", "views"), "the record")
    if record["kind"] not in KINDS:
        raise Refused("record", f"kind {record['kind']!r} is unknown")
    identity = fields(record["identity"], ("contributor",), ("number", "key"), "identity")
    seen = fields(record["seen"], ("size", "root"), (), "seen")
    digests = fields(record["digests"], NEEDS.get(record["kind"], ()), DIGESTS, "digests")
    for what, value in [*((w, record[w]) for w in ("origin", "scene", "purpose")), ("contributor", identity["contributor"])]:
        short_text(value, what)
    check_identity(record, identity, digests)
    whole(seen["size"], 0, 2**53, "seen.size")
    hexes = [("seen.root", seen["root"]), *((w, record[w]) for w in ("scene_salt", "owner_key", "nonce")), *digests.items()]
    for what, value in hexes:
        hex32(value, what)
    if "seed" in record:
        decimal(record["seed"] if isinstance(record["seed"], str) else "", "record", "seed")
    elif record["kind"] == "training":
        raise Refused("record", "a training without its seed")
    if "replaces" in record:
        hex32(record["replaces"], "replaces")
    elif record["kind"] in ("rotation", "dispute"):
        raise Refused("record", f"a {record['kind']} that names no record")
    if "views" in record:
        check_views(record["views"], digests)
    return record


def check_identity(record, identity, digests):
    """A number belongs to a mark, a key to a binding."""
    if "number" in identity:
        whole(identity["number"], 1, 2**32, "identity.number")
        if record["kind"] == "claim":
            fields(digests, MARK, DIGESTS, "digests of a mark")
    if record["kind"] == "training" and ("marked_field" in digests) != ("detector" in digests):
        raise Refused("record", "a training with one of marked field and detector")
    if ("key" in identity) != (record["kind"] == "binding"):
        raise Refused("record", "identity.key stands in bindings, and in no other record")
    if "key" in identity:
        hex32(identity["key"], "identity.key")
        if "number" in identity or "replaces" in record or "views" in record:
            raise Refused("record", "a binding is about a name and a key alone")


def check_views(views, digests):
    if not isinstance(views, list) or not 1 <= len(views) <= 512:
        raise Refused("record", "views are not 1 to 512 digests")
    raw = [hex32(view, "views") for view in views]
    if raw != sorted(set(raw)):
        raise Refused("record", "views are not sorted, or one stands twice")
    if tree_root([leaf_hash(view) for view in raw]).hex() != digests.get("photographs"):
        raise Refused("record", "digests.photographs is not the root over the views")


def make_leaf(record, record_digest, signature):
    """version | kind | SHA-256(PAE) | SHA-256(owner key) | salted scene commitment | signature: 162 bytes."""
    owner = sha256(bytes.fromhex(record["owner_key"]))
    scene = sha256(b"cairn scene v1\0", bytes.fromhex(record["scene_salt"]), record["scene"].encode())
    leaf = bytes([1, KINDS[record["kind"]]]) + record_digest + owner + scene + signature
    assert len(leaf) == 162
    return leaf
