'use strict';

/** CRC of `data`, most significant bit first, without reflection: the checksum of SDO block transfer, as canopen asks. */
function crc(bits, reflect, polynomial, polynomialLow, initial, initialLow, xor, xorLow, data) {
    if (bits !== 16 || reflect || initial || xor)
        throw new RangeError('only the CRC of SDO block transfer is here');

    let register = 0;
    for (const byte of data) {
        register ^= byte << 8;
        for (let bit = 0; bit < 8; ++bit)
            register = register & 0x8000 ? ((register << 1) ^ polynomial) & 0xFFFF : register << 1;
    }
    return Buffer.from([register >> 8, register & 0xFF]);
}

module.exports = { crc };
