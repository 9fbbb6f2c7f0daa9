// Reads and writes the ledger's values: MessagePack, bytes as hexadecimal. Never guesses: what it does not know it refuses.

/** A byte string of the chain, by its hexadecimal text. */
export class Bytes {
  constructor(hex) {
    this.hex = hex;
  }
}

function bytesOf(hex) {
  const bytes = new Uint8Array(hex.length / 2);
  for (let index = 0; index < bytes.length; index += 1) bytes[index] = parseInt(hex.substr(2 * index, 2), 16);
  return bytes;
}

function hexOf(bytes) {
  let hex = "";
  for (const byte of bytes) hex += byte.toString(16).padStart(2, "0");
  return hex;
}

function plain(number) {
  return number >= BigInt(Number.MIN_SAFE_INTEGER) && number <= BigInt(Number.MAX_SAFE_INTEGER) ? Number(number) : number;
}

class Reader {
  constructor(bytes) {
    this.bytes = bytes;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    this.at = 0;
  }

  take(size) {
    if (this.at + size > this.bytes.length) throw new Error("the value is cut off");
    const part = this.bytes.subarray(this.at, this.at + size);
    this.at += size;
    return part;
  }

  count(size) {
    let number = 0;
    for (const byte of this.take(size)) number = number * 256 + byte;
    return number;
  }

  text(size) {
    return new TextDecoder("utf-8", { fatal: true }).decode(this.take(size));
  }

  binary(size) {
    return new Bytes(hexOf(this.take(size)));
  }

  list(size) {
    return Array.from({ length: size }, () => this.value());
  }

  map(size) {
    return new Map(Array.from({ length: size }, () => [this.value(), this.value()]));
  }

  large(size) {
    if (this.count(1) !== 1) throw new Error("an unknown extension");
    return BigInt.asIntN(8 * size, BigInt(`0x${hexOf(this.take(size)) || "0"}`));
  }

  value() {
    const kind = this.count(1);
    if (kind < 0x80) return kind;
    if (kind < 0x90) return this.map(kind & 15);
    if (kind < 0xa0) return this.list(kind & 15);
    if (kind < 0xc0) return this.text(kind & 31);
    if (kind >= 0xe0) return kind - 256;
    if (kind >= 0xd4 && kind <= 0xd8) return this.large(1 << (kind - 0xd4));
    switch (kind) {
      case 0xc0: return null;
      case 0xc2: return false;
      case 0xc3: return true;
      case 0xc4: case 0xc5: case 0xc6: return this.binary(this.count(1 << (kind - 0xc4)));
      case 0xc7: return this.large(this.count(1));
      case 0xcc: case 0xcd: case 0xce: return this.count(1 << (kind - 0xcc));
      case 0xcf: this.at += 8; return plain(this.view.getBigUint64(this.at - 8));
      case 0xd0: this.at += 1; return this.view.getInt8(this.at - 1);
      case 0xd1: this.at += 2; return this.view.getInt16(this.at - 2);
      case 0xd2: this.at += 4; return this.view.getInt32(this.at - 4);
      case 0xd3: this.at += 8; return plain(this.view.getBigInt64(this.at - 8));
      case 0xd9: case 0xda: case 0xdb: return this.text(this.count(1 << (kind - 0xd9)));
      case 0xdc: case 0xdd: return this.list(this.count(2 << (kind - 0xdc)));
      case 0xde: case 0xdf: return this.map(this.count(2 << (kind - 0xde)));
      default: throw new Error(`an unknown kind of value: ${kind}`);
    }
  }
}

/** Read a value from hexadecimal text. Maps are `Map`s, byte strings `Bytes`, whole numbers beyond 2^53 `BigInt`s. */
export function decode(hex) {
  const reader = new Reader(bytesOf(hex));
  const value = reader.value();
  if (reader.at !== reader.bytes.length) throw new Error("bytes are left over");
  return value;
}

/** Write a list of texts, byte strings and whole numbers from 0 to 2^32-1, in canonical form, as hexadecimal text. */
export function encodeList(items) {
  return `${(0x90 + items.length).toString(16)}${items.map(encodeItem).join("")}`;
}

function sized(size, kinds) {
  const place = size < 0x100 ? 0 : size < 0x10000 ? 1 : 2;
  return kinds[place].toString(16) + size.toString(16).padStart(2 << place, "0");
}

function encodeItem(item) {
  if (item instanceof Bytes) return sized(item.hex.length / 2, [0xc4, 0xc5, 0xc6]) + item.hex;
  if (typeof item === "number") return item < 0x80 ? item.toString(16).padStart(2, "0") : sized(item, [0xcc, 0xcd, 0xce]);
  const bytes = new TextEncoder().encode(item);
  return (bytes.length < 32 ? (0xa0 + bytes.length).toString(16) : sized(bytes.length, [0xd9, 0xda, 0xdb])) + hexOf(bytes);
}
