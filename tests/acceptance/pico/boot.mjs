// The action of the boot ROM on an image in flash (datasheet 2.8.1.3): it checks the CRC of the
// second boot stage, copies that to the end of SRAM and enters it with LR = 0.
import { readFileSync } from 'node:fs';

const STAGE_BYTES = 252;
const STAGE_AT = 0x20041f00;
const SRAM_AT = 0x20000000;
const FLASH_AT = 0x10000000;
const STACK_TOP = 0x20042000;
const UF2_BLOCK = 512;
const UF2_MAGIC = [0x0a324655, 0x9e5d5157, 0x0ab16f30];
const RP2040_FAMILY = 0xe48bff56;

// Polynomial 04C11DB7, start FFFFFFFF, no reflection.
export function crc32(data) {
  let crc = 0xffffffff;
  for (const byte of data) {
    crc = (crc ^ (byte << 24)) >>> 0;
    for (let bit = 0; bit < 8; bit++) {
      crc = (crc & 0x80000000 ? (crc << 1) ^ 0x04c11db7 : crc << 1) >>> 0;
    }
  }
  return crc >>> 0;
}

// The flash bytes of a .uf2 or .bin file.
export function readImage(path) {
  const file = readFileSync(path);
  return path.endsWith('.uf2') ? unpacked(file) : file;
}

function unpacked(file) {
  const blocks = file.length / UF2_BLOCK;
  if (!Number.isInteger(blocks) || !blocks) throw new Error(`${file.length} bytes are no UF2 file`);
  const pieces = [];
  for (let index = 0; index < blocks; index++) {
    const block = file.subarray(index * UF2_BLOCK, (index + 1) * UF2_BLOCK);
    pieces.push(payload(block, index, blocks));
  }
  return Buffer.concat(pieces);
}

// The boot ROM accepts pages of 256 bytes, for this family, in any order; these are in order.
function payload(block, index, blocks) {
  const word = (at) => block.readUInt32LE(at);
  const magic = [word(0), word(4), word(508)];
  const wanted = [FLASH_AT + 256 * index, 256, index, blocks, RP2040_FAMILY];
  const found = [word(12), word(16), word(20), word(24), word(28)];
  if (`${magic}` !== `${UF2_MAGIC}` || `${found}` !== `${wanted}`) {
    throw new Error(`UF2 block ${index}: ${found} in place of ${wanted}`);
  }
  return block.subarray(32, 288);
}

// Enter the image in `mcu`; return false if the ROM would refuse it (it then waits as a USB drive).
export function enter(mcu, image) {
  const stage = image.subarray(0, STAGE_BYTES);
  if (crc32(stage) !== image.readUInt32LE(STAGE_BYTES)) return false;
  mcu.sram.set(stage, STAGE_AT - SRAM_AT);
  const { core } = mcu;
  core.VTOR = 0;
  core.SP = STACK_TOP;
  core.LR = 0;
  core.PC = STAGE_AT;
  return true;
}
