#include "client/ray_reader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <thread>

#include "tests/unit/client/test_session.h"

namespace deltaray {
namespace {

using ::testing::EndsWith;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr double kInfiniteDouble = std::numeric_limits<double>::infinity();

// All numbers of a CSV file, read in batches of two rays.
absl::StatusOr<std::vector<double>> ReadCsv(const std::string& text, v1::RayLayout* layout = nullptr) {
  TestSession session;
  session.SetInput(text);
  auto reader = OpenCsvRays(*InputFile::Open("-", session.session()));
  if (!reader.ok()) return reader.status();
  if (layout != nullptr) *layout = (*reader)->layout();
  std::string rays;
  while (true) {
    const absl::StatusOr<size_t> count = (*reader)->Read(2, &rays);
    if (!count.ok()) return count.status();
    if (*count == 0) break;
    EXPECT_LE(*count, 2u);
  }
  std::vector<double> numbers(rays.size() / sizeof(double));
  rays.copy(reinterpret_cast<char*>(numbers.data()), rays.size());
  return numbers;
}

std::string CsvError(const std::string& text) { return std::string(ReadCsv(text).status().message()); }

TEST(CsvRayReaderTest, ReadsSixColumns) {
  v1::RayLayout layout;
  EXPECT_EQ(*ReadCsv("1,2,3,4,5,6\n-1.5,2e3,+3,0.1,-0,6\n7,8,9,10,11,12\n", &layout),
            (std::vector<double>{1, 2, 3, 4, 5, 6, -1.5, 2000, 3, 0.1, -0.0, 6, 7, 8, 9, 10, 11, 12}));
  EXPECT_EQ(layout, v1::RAY_LAYOUT_FLOAT64X6);
}

TEST(CsvRayReaderTest, ReadsEightColumnsWithInfiniteInterval) {
  v1::RayLayout layout;
  EXPECT_EQ(*ReadCsv("1,2,3,4,5,6,-inf,inf\n", &layout),
            (std::vector<double>{1, 2, 3, 4, 5, 6, -kInfiniteDouble, kInfiniteDouble}));
  EXPECT_EQ(layout, v1::RAY_LAYOUT_FLOAT64X8);
}

TEST(CsvRayReaderTest, TakesColumnsInTheOrderOfTheHeader) {
  EXPECT_EQ(*ReadCsv("dx,dy,dz,oz,oy,ox\n1,2,3,4,5,6\n"), (std::vector<double>{6, 5, 4, 1, 2, 3}));
}

TEST(CsvRayReaderTest, SkipsEmptyLinesCommentsAndSpaces) {
  EXPECT_EQ(*ReadCsv("# rays\r\n\r\n 1 ,2,\t3,4,5,6\r\n\n# end\n6,5,4,3,2,1"),
            (std::vector<double>{1, 2, 3, 4, 5, 6, 6, 5, 4, 3, 2, 1}));
}

TEST(CsvRayReaderTest, SkipsTheByteOrderMark) {
  EXPECT_EQ(*ReadCsv("\xEF\xBB\xBFox,oy,oz,dx,dy,dz\n1,2,3,4,5,6\n"), (std::vector<double>{1, 2, 3, 4, 5, 6}));
  EXPECT_EQ(*ReadCsv("\xEF\xBB\xBF"
                     "1,2,3,4,5,6\n"),
            (std::vector<double>{1, 2, 3, 4, 5, 6}));
}

TEST(CsvRayReaderTest, EmptyFileHasNoRays) {
  EXPECT_TRUE(ReadCsv("")->empty());
  EXPECT_TRUE(ReadCsv("ox,oy,oz,dx,dy,dz\n")->empty());
}

TEST(CsvRayReaderTest, KeepsAllDigitsOfDoubles) {
  EXPECT_EQ((*ReadCsv("5432109.123456789,0,0,0,0,1"))[0], 5432109.123456789);
}

TEST(CsvRayReaderTest, RoundsNumbersThatAreTooSmall) {
  const std::vector<double> numbers = *ReadCsv("1e-400,-1e-400,2e-324,3e-324,1e-310,1\n");
  EXPECT_EQ(numbers, (std::vector<double>{0, -0.0, 0, 0x1p-1074, 1e-310, 1}));
  EXPECT_TRUE(std::signbit(numbers[1]));
  EXPECT_THAT(CsvError("1e-400x,2,3,4,5,6\n"), HasSubstr("'1e-400x' is neither"));
  EXPECT_THAT(CsvError("1,2,3,4,5,6,0,1e999\n"), HasSubstr("column t_max: '1e999' is not a number"));
}

TEST(CsvRayReaderTest, NamesLineAndColumnOfBadNumbers) {
  EXPECT_EQ(CsvError("1,2,3,4,5,6\n\n1,2,3,4,x,6\n"), "standard input: line 3: column dy: 'x' is not a finite number");
  EXPECT_THAT(CsvError("1,2,3,4,5,6\n1,2,3,4,5,nan\n"), HasSubstr("line 2: column dz: 'nan' is not a finite number"));
  EXPECT_THAT(CsvError("1,2,inf,4,5,6\n"), HasSubstr("line 1: column oz: 'inf' is not a finite number"));
  EXPECT_THAT(CsvError("1,2,3,4,5,6,nan,1\n"), HasSubstr("column t_min: 'nan' is not a number"));
  EXPECT_THAT(CsvError("1,2,3,4,5,\n"), HasSubstr("column dz: '' is not"));
  EXPECT_THAT(CsvError("1,2,3,4,5,6 7\n"), HasSubstr("'6 7' is not"));
  EXPECT_THAT(CsvError("1,2,3,4,5,1e999\n"), HasSubstr("'1e999' is not"));
  EXPECT_THAT(CsvError("1,2,3,4,5,+-6\n"), HasSubstr("'+-6' is not"));
}

TEST(CsvRayReaderTest, NamesLineOfBadColumnCounts) {
  EXPECT_THAT(CsvError("1,2,3,4,5\n"), HasSubstr("line 1: has 5 columns; a ray has 6 or 8"));
  EXPECT_THAT(CsvError("1,2,3,4,5,6,7\n"), HasSubstr("line 1: has 7 columns"));
  EXPECT_THAT(CsvError("1,2,3,4,5,6\n1,2,3,4,5,6,7,8\n"), HasSubstr("line 2: has 8 fields, not 6"));
  EXPECT_THAT(CsvError("1 2 3 4 5 6\n"), HasSubstr("line 1: '1 2 3 4 5 6' is neither a number nor a column"));
}

TEST(CsvRayReaderTest, RefusesBadHeaders) {
  EXPECT_THAT(CsvError("ox,oy,oz,dx,dy,color\n"), HasSubstr("line 1: 'color' is neither a number nor a column"));
  EXPECT_THAT(CsvError("ox,oy,oz,dx,dy,dy\n"), HasSubstr("column dy stands twice"));
  EXPECT_THAT(CsvError("ox,oy,oz,dx,dy\n"), HasSubstr("column dz is missing"));
  EXPECT_THAT(CsvError("ox,oy,oz,dx,dy,dz,t_max\n"), HasSubstr("column t_min is missing"));
}

// Raw rays without --rays-format put their bytes on the terminal.
TEST(CsvRayReaderTest, ErrorsArePrintableAndTellOfBinaryFiles) {
  const std::string hint = "; is it binary? see --rays-format";
  const std::string zero(1, '\0');
  EXPECT_EQ(CsvError("\xC0\x3F" + zero + "\x1B,\n"),
            "standard input: line 1: '\\xc0?\\x00\\x1b' is neither a number nor " +
                ("a column; columns are ox,oy,oz,dx,dy,dz,t_min,t_max" + hint));
  EXPECT_THAT(CsvError(std::string(1 << 16, '\0')), HasSubstr("is longer than 4095 bytes" + hint));
  EXPECT_THAT(CsvError("1,2,3,4,5,6\n1,2,3,4,5,\1\n"), HasSubstr("'\\x01' is not a finite number" + hint));
  EXPECT_THAT(CsvError("x\xFFy\n"), HasSubstr("'x\\xffy' is neither"));
  const std::string row(4000, 'x');
  EXPECT_THAT(CsvError(row + "\n"), HasSubstr("line 1: '" + row.substr(0, 40) + "…' is neither"));
  // Text: a tab, the end of a line of Windows, a byte order mark, a minus that is none.
  EXPECT_THAT(CsvError("\xEF\xBB\xBFo\tx\r\n"), Not(HasSubstr(hint)));
  EXPECT_THAT(CsvError("1,2,3,4,5,6\n1,2,3,4,5,\u22126\n"), EndsWith("'\\xe2\\x88\\x92\\x36' is not a finite number"));
}

TEST(CsvRayReaderTest, RefusesEndlessLines) {
  EXPECT_THAT(CsvError("1,2,3,4,5,6\n" + std::string(1 << 20, '1')), HasSubstr("line 2: is longer than 4095 bytes"));
  // A line that is as long as allowed, across the ends of the reader's buffer.
  std::string text;
  const std::string line = "1,2,3,4,5," + std::string(4084, '0') + "6\n";
  for (int i = 0; i < 40; ++i) text += line;
  EXPECT_EQ(ReadCsv(text)->size(), 40u * 6);
  EXPECT_THAT(CsvError("0" + line), HasSubstr("line 1: is longer"));
}

TEST(RawRayReaderTest, ReadsBatches) {
  TestSession session;
  std::string bytes(5 * 24, '\0');
  for (size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<char>(i);
  session.SetInput(bytes);
  const auto reader = OpenRawRays(*InputFile::Open("-", session.session()), v1::RAY_LAYOUT_FLOAT32X6);
  std::string rays;
  EXPECT_EQ(*reader->Read(3, &rays), 3u);
  EXPECT_EQ(rays.size(), 3u * 24);
  EXPECT_EQ(*reader->Read(3, &rays), 2u);
  EXPECT_EQ(rays, bytes);
  EXPECT_EQ(*reader->Read(3, &rays), 0u);
}

TEST(RawRayReaderTest, RefusesATruncatedRay) {
  const struct {
    v1::RayLayout layout;
    size_t bytes;
    const char* error;
  } cases[] = {{v1::RAY_LAYOUT_FLOAT32X6, 24 * 3 + 4, "ends inside ray 3, after 4 of its 24 bytes"},
               {v1::RAY_LAYOUT_FLOAT32X8, 31, "ends inside ray 0, after 31 of its 32 bytes"},
               {v1::RAY_LAYOUT_FLOAT64X6, 49, "ends inside ray 1, after 1 of its 48 bytes"},
               {v1::RAY_LAYOUT_FLOAT64X8, 63, "ends inside ray 0, after 63 of its 64 bytes"}};
  for (const auto& test : cases) {
    TestSession session;
    session.SetInput(std::string(test.bytes, '\0'));
    const auto reader = OpenRawRays(*InputFile::Open("-", session.session()), test.layout);
    std::string rays;
    absl::StatusOr<size_t> count = 1;
    while (count.ok() && *count > 0) count = reader->Read(2, &rays);
    EXPECT_THAT(std::string(count.status().message()), HasSubstr(test.error));
  }
}

TEST(InputFileTest, StopEndsAReadThatWaits) {
  TestSession session;
  int pipe_ends[2];
  ASSERT_EQ(pipe(pipe_ends), 0);
  session.SetInputFd(pipe_ends[0]);
  auto file = InputFile::Open("-", session.session());
  std::thread stopper([&] { session.stop.Fire(); });
  char byte;
  EXPECT_EQ(file->Read(std::span(&byte, 1)).status().code(), absl::StatusCode::kCancelled);
  stopper.join();
  close(pipe_ends[1]);
}

TEST(InputFileTest, NamesWhatCannotBeRead) {
  TestSession session;
  EXPECT_THAT(std::string(InputFile::Open("/no/such", session.session()).status().message()),
              HasSubstr("cannot open /no/such: No such file"));
  EXPECT_THAT(std::string(InputFile::Open("/tmp", session.session()).status().message()), HasSubstr("is a directory"));
}

}  // namespace
}  // namespace deltaray
