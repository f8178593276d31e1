/* The C library in a firmware that does what examples/size/src/bin/frames.rs does: 12 messages in, every field of each read, 8
 * out. With EMPTY it is the loop and nothing else. With RUN it is what benches/compare/firmware runs: the line is its, and so is
 * the counting. */

#include <stdint.h>

#define LOOK(p) __asm__ volatile("" : : "g"(p) : "memory")

#define BASE 0x40004000u
#define REGISTER(offset) (*(volatile uint32_t *)(BASE + (offset)))
#define TX_FULL 1u
#define RX_FULL 2u

static void put(uint8_t byte) {
    while (REGISTER(4) & TX_FULL) {
    }
    REGISTER(0) = byte;
}

#ifdef RUN
#include <stdbool.h>
#include <stddef.h>
size_t compare_read(uint8_t *out, size_t len);
void compare_send(const uint8_t *bytes, size_t len);
#endif

#ifdef EMPTY

int main(void) {
    for (;;) {
        if (REGISTER(4) & RX_FULL) {
            put((uint8_t)REGISTER(0));
        }
    }
}

#else

#define MAVLINK_USE_CONVENIENCE_FUNCTIONS
#define MAVLINK_COMM_NUM_BUFFERS 1
#define MAVLINK_SEND_UART_BYTES send_bytes

#include "mavlink_types.h"
static mavlink_system_t mavlink_system = {1, 1};
static void send_bytes(mavlink_channel_t chan, const uint8_t *bytes, uint16_t len) {
    (void)chan;
#ifdef RUN
    compare_send(bytes, len);
    return;
#endif
    while (len--) {
        put(*bytes++);
    }
}
#include "common/mavlink.h"

#define READ(name)                                    \
    mavlink_##name##_t in;                            \
    mavlink_msg_##name##_decode(&received, &in);      \
    LOOK(&in)

static mavlink_message_t received;
static mavlink_status_t status;
/* Values that the compiler does not know. */
static volatile uint8_t value;

static void acknowledge(uint16_t command) {
    mavlink_msg_command_ack_send(MAVLINK_COMM_0, command, value, 255, 0, received.sysid, received.compid);
}

static void handle(void) {
    switch (received.msgid) {
    case MAVLINK_MSG_ID_HEARTBEAT: {
        READ(heartbeat);
        mavlink_msg_heartbeat_send(MAVLINK_COMM_0, MAV_TYPE_QUADROTOR, MAV_AUTOPILOT_GENERIC, value, value, value);
        break;
    }
    case MAVLINK_MSG_ID_COMMAND_LONG: {
        READ(command_long);
        acknowledge(in.command);
        break;
    }
    case MAVLINK_MSG_ID_COMMAND_INT: {
        READ(command_int);
        acknowledge(in.command);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_COUNT: {
        READ(mission_count);
        mavlink_mission_request_int_t out = {.seq = in.count, .mission_type = in.mission_type};
        mavlink_msg_mission_request_int_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_ITEM_INT: {
        READ(mission_item_int);
        mavlink_mission_ack_t out = {.type = value, .mission_type = in.mission_type};
        mavlink_msg_mission_ack_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_REQUEST_INT: {
        READ(mission_request_int);
        mavlink_mission_item_int_t out = {0};
        LOOK(&out);
        out.seq = in.seq;
        mavlink_msg_mission_item_int_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_REQUEST_LIST: {
        READ(mission_request_list);
        mavlink_mission_count_t out = {0};
        LOOK(&out);
        out.count = value;
        out.mission_type = in.mission_type;
        mavlink_msg_mission_count_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_ACK: {
        READ(mission_ack);
        break;
    }
    case MAVLINK_MSG_ID_MISSION_CLEAR_ALL: {
        READ(mission_clear_all);
        break;
    }
    case MAVLINK_MSG_ID_PARAM_REQUEST_LIST: {
        READ(param_request_list);
        break;
    }
    case MAVLINK_MSG_ID_PARAM_REQUEST_READ: {
        READ(param_request_read);
        mavlink_param_value_t out = {0};
        LOOK(&out);
        mav_array_memcpy(out.param_id, in.param_id, sizeof out.param_id);
        mavlink_msg_param_value_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    case MAVLINK_MSG_ID_PARAM_SET: {
        READ(param_set);
        mavlink_statustext_t out = {.severity = value, .text = "parameter set"};
        mavlink_msg_statustext_send_struct(MAVLINK_COMM_0, &out);
        break;
    }
    }
}

#ifdef RUN

uint32_t compare_run(bool framing) {
    uint8_t bytes[64];
    uint32_t frames = 0;
    for (size_t len; (len = compare_read(bytes, sizeof bytes)) > 0;) {
        for (size_t i = 0; i < len; i++) {
            if (mavlink_parse_char(MAVLINK_COMM_0, bytes[i], &received, &status)) {
                frames++;
                if (framing) {
                    LOOK(&received);
                } else {
                    handle();
                }
            }
        }
    }
    return frames;
}

#else

int main(void) {
    for (;;) {
        if (REGISTER(4) & RX_FULL && mavlink_parse_char(MAVLINK_COMM_0, (uint8_t)REGISTER(0), &received, &status)) {
            handle();
        }
    }
}

#endif

#endif
