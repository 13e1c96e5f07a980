// MRPT's own LMS2xx driver in the hands of somebody who carries on: a driver that reports an error is made anew.
//
//   mrpt_recover PORT BAUD SECONDS
//
// Prints lines that a test reads, as things happen:
//   connected | hardware error | scan <n values> <range straight ahead>
#include <mrpt/hwdrivers/CSickLaserSerial.h>
#include <mrpt/obs/CObservation2DRangeScan.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <thread>

using Clock = std::chrono::steady_clock;

int main(int argc, char** argv)
{
	if (argc != 4)
	{
		std::fprintf(stderr, "usage: mrpt_recover PORT BAUD SECONDS\n");
		return 2;
	}
	const auto end = Clock::now() + std::chrono::seconds(std::atoi(argv[3]));
	std::unique_ptr<mrpt::hwdrivers::CSickLaserSerial> laser;
	while (Clock::now() < end)
	{
		bool there = false, error = false;
		mrpt::obs::CObservation2DRangeScan scan;
		const bool fresh = !laser;
		try
		{
			if (fresh)
			{
				laser = std::make_unique<mrpt::hwdrivers::CSickLaserSerial>();
				laser->setSerialPort(argv[1]);
				laser->setBaudRate(std::atoi(argv[2]));
				laser->setScanFOV(180);
				laser->setScanResolution(100);
			}
			laser->doProcessSimple(there, scan, error);
		}
		catch (const std::exception&)
		{
			error = true;
		}
		if (error)
		{
			std::printf("hardware error\n");
			laser.reset();
			std::this_thread::sleep_for(std::chrono::milliseconds(200));
		}
		else if (fresh)
			std::printf("connected\n");
		if (there)
		{
			const size_t n = scan.getScanSize();
			std::printf("scan %zu %.3f\n", n, double(scan.getScanRange(n / 2)));
		}
		std::fflush(stdout);
	}
	return 0;
}
