// The robot's shared memory for .NET programs on the computer of the daemon (Linux).
//
// Made by `hilserver signals --format csharp`; it fits the configuration it was made with, which
// HilImage checks. Reading never delays the robot, and a half-written frame is never returned.
using System;
using System.IO;
using System.IO.MemoryMappedFiles;
using System.Runtime.InteropServices;
using System.Text;
using System.Threading;

namespace Hilserver
{
    /// <summary>Every signal in its unit; in: written to the robot.</summary>
    [StructLayout(LayoutKind.Sequential, Pack = 8)]
    public struct HilValues
    {
@VALUES@
    }

    /// <summary>Their status, an OPC UA status code; 0 is Good.</summary>
    [StructLayout(LayoutKind.Sequential, Pack = 8)]
    public struct HilStatus
    {
@STATUS@
    }

    /// <summary>One tick of the robot.</summary>
    [StructLayout(LayoutKind.Sequential, Pack = 8)]
    public struct HilFrame
    {
        public long Sequence;   // 2 n + 2 for frame n
        public long Tick;       // that computed the values
        public long PlannedNs;  // its planned start, CLOCK_MONOTONIC
        public long Latched;    // input rows taken over so far
        public HilValues Values;
        public HilStatus Status;
    }

    /// <summary>What a program writes (shared_memory.grants); NaN: left to others.</summary>
    [StructLayout(LayoutKind.Sequential, Pack = 8)]
    public struct HilWritten
    {
@WRITTEN@

        /// <summary>Writes nothing yet.</summary>
        public static HilWritten Nothing()
        {
            return new HilWritten
            {
@NOTHING@
            };
        }
    }

    /// <summary>The process image of a running daemon.</summary>
    public sealed class HilImage : IDisposable
    {
        public const string Path = "@IMAGE@";
        internal const long Layout = @LAYOUT@;
        private const int RingLength = 5, RingStride = 6, RingBase = 7, RingHead = 8, Text = 64;
        private readonly MemoryMappedFile _file;
        private readonly MemoryMappedViewAccessor _memory;

        public HilImage(string path = Path)
        {
            _file = MemoryMappedFile.CreateFromFile(
                new FileStream(path, FileMode.Open, FileAccess.Read, FileShare.ReadWrite), null, 0,
                MemoryMappedFileAccess.Read, HandleInheritability.None, false);
            _memory = _file.CreateViewAccessor(0, 0, MemoryMappedFileAccess.Read);
            if (Word(0) != 0x48494C5345525652 || Word(1) != @VERSION@)
                throw new InvalidDataException("another version of hilserver runs");
            if (Found() != Layout)
                throw new InvalidDataException(
                    "the robot has other signals: make this file again, with its configuration");
        }

        /// <summary>Copy the newest frame; false if there is none yet.</summary>
        public bool Read(out HilFrame frame)
        {
            frame = default(HilFrame);
            for (int tries = 0; tries < 8; tries++)
            {
                long head = Word(RingHead);
                Thread.MemoryBarrier();
                if (head == 0)
                    return false;
                long place = (head - 1) & (Word(RingLength) - 1);
                long row = 8 * (Word(RingBase) + place * Word(RingStride));
                long begun = _memory.ReadInt64(row);
                Thread.MemoryBarrier();
                _memory.Read(row, out frame);
                Thread.MemoryBarrier();
                if (begun == 2 * head && _memory.ReadInt64(row) == begun)
                    return true;
            }
            return false;
        }

        public void Dispose()
        {
            _memory.Dispose();
            _file.Dispose();
        }

        private long Word(long index)
        {
            return _memory.ReadInt64(8 * index);
        }

        private long Found()
        {
            byte[] text = new byte[Word(2)];
            _memory.ReadArray(8 * Text, text, 0, text.Length);
            int length = Encoding.ASCII.GetString(text).IndexOf("@HEAD_END@", StringComparison.Ordinal);
            ulong number = 0xcbf29ce484222325;
            for (int i = 0; i < length; i++)
                number = unchecked((number ^ text[i]) * 0x100000001b3);
            return (long)(number >> 1);
        }
    }

    /// <summary>What one program at a time writes, where shared_memory.grants allows it.</summary>
    public sealed class HilInputs : IDisposable
    {
        public const string Path = "@INPUTS@";
        private readonly MemoryMappedFile _file;
        private readonly MemoryMappedViewAccessor _memory;

        public HilInputs(string path = Path)
        {
            _file = MemoryMappedFile.CreateFromFile(
                new FileStream(path, FileMode.Open, FileAccess.ReadWrite, FileShare.ReadWrite), null, 0,
                MemoryMappedFileAccess.ReadWrite, HandleInheritability.None, false);
            _memory = _file.CreateViewAccessor();
            if (_memory.ReadInt64(0) != HilImage.Layout)
                throw new InvalidDataException(
                    "the robot has other signals: make this file again, with its configuration");
        }

        /// <summary>Write all inputs together. Call it in every cycle, also without news.</summary>
        public void Write(ref HilWritten values)
        {
            long counter = _memory.ReadInt64(8) | 1;
            _memory.Write(8, counter);
            Thread.MemoryBarrier();
            _memory.Write(16, ref values);
            Thread.MemoryBarrier();
            _memory.Write(8, counter + 1);
        }

        public void Dispose()
        {
            _memory.Dispose();
            _file.Dispose();
        }
    }
}
